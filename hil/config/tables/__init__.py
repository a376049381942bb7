"""Tables of scenario and rig files, each a model with ranges and units; the models of whole files are above."""
