"""Files for the controller: Ethernet configuration, program, and the objects that a person draws in RSI Visual."""

from __future__ import annotations

from typing import Final

from hil_kuka_rsi.codec import CARTESIAN
from hil_kuka_rsi.entry import RsiSettings

_SENT: Final = ("DEF_RIst", "DEF_RSol", "DEF_AIPos", "DEF_Delay")
_PORT: Final = 49152

_ETHERNET = """<ROOT>
  <CONFIG>
    <IP_NUMBER>{host}</IP_NUMBER>
    <PORT>{port}</PORT>
    <SENTYPE>{sen_type}</SENTYPE>
    <ONLYSEND>FALSE</ONLYSEND>
  </CONFIG>
  <SEND>
    <ELEMENTS>
{send}
    </ELEMENTS>
  </SEND>
  <RECEIVE>
    <ELEMENTS>
{receive}
    </ELEMENTS>
  </RECEIVE>
</ROOT>
"""

_PROGRAM = """&ACCESS RVO
DEF hil_bench()
; Moves nothing by itself: put the robot where the run starts, in T1, then start this program.
DECL INT ret, context
BAS(#INITMOV, 0)
PTP $POS_ACT
ret = RSI_CREATE("hil_bench.rsi", context, TRUE)
IF (ret <> RSIOK) THEN
  HALT
ENDIF
ret = RSI_ON(#{mode}, {cycle})
IF (ret <> RSIOK) THEN
  HALT
ENDIF
RSI_MOVECORR()            ; until RSI ends: late answers, a limit of POSCORR, a stop
ret = RSI_OFF()
END
"""

_OBJECTS = """# Objects of hil_bench.rsi

Draw them in RSI Visual and save them as hil_bench.rsi. Numbers of ports are those of hil_bench_ethernet.xml.

| object | settings |
|---|---|
| ETHERNET | configuration file hil_bench_ethernet.xml, Timeout = {late_max} |
| POSCORR | inputs RKorr.X to RKorr.C, RefCorrSys = #BASE, LowerLimX to UpperLimZ, MaxRotAngle |
| POSCORRMON | its six outputs to ports 1 to 6 |
| STATUS | 1 while the correction is active, 2 afterwards, 4 in a safety stop, to port 7 |

ETHERNET: after so many late answers in a row the controller stops; this is what stops the robot if the bench fails.
POSCORR: the limits of the correction are those of the cell, never wider than its risk assessment allows. POSCORRMON:
the bench continues from the correction that acts. STATUS: the cause of a stop is named.

HOLDON = 1: a late answer leaves the last correction at its output, so that the pose stays. With mode = "{mode}" the
correction is {meaning}. Cycle: {period_ms} ms, RSI_ON with {cycle}.
"""


def controller_files(settings: RsiSettings) -> dict[str, str]:
    """Return the texts by the names of the files."""
    send = [f'      <ELEMENT TAG="{tag}" TYPE="{_kind(tag)}" INDX="INTERNAL"/>' for tag in _SENT]
    send += [_element(f"PosCorrMon.{axis}", number) for number, axis in enumerate(CARTESIAN, 1)]
    send += ['      <ELEMENT TAG="Stat" TYPE="LONG" INDX="7"/>']
    receive = [_element(f"RKorr.{axis}", number, ' HOLDON="1"') for number, axis in enumerate(CARTESIAN, 1)]
    cycle = "#IPO_FAST" if settings.period_ms == 4 else "#IPO"
    relative = settings.mode == "relative"
    values = {
        **settings.model_dump(),
        "port": settings.port or _PORT,
        "mode": settings.mode.upper(),
        "cycle": cycle,
        "meaning": "added to the last pose in each cycle" if relative else "added to the pose at its start",
        "send": "\n".join(send),
        "receive": "\n".join(receive),
    }
    return {
        "hil_bench_ethernet.xml": _ETHERNET.format(**values),
        "hil_bench.src": _PROGRAM.format(**values),
        "hil_bench_rsi.md": _OBJECTS.format(**values),
    }


def _kind(tag: str) -> str:
    return "LONG" if tag == "DEF_Delay" else "DOUBLE"


def _element(tag: str, number: int, more: str = "") -> str:
    return f'      <ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="{number}"{more}/>'
