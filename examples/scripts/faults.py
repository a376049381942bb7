"""A study of one fault: what the run makes of poses that are lost for a growing time."""

import hil

for lost_s in (1.0, 5.0, 20.0):
    fault = {"device": "vmu", "kind": "no_pose", "at_s": 60.0, "until_s": 60.0 + lost_s}
    run = hil.run("scheme-1", faults=[fault])
    print(lost_s, run.accepted, run.why()["text"])
