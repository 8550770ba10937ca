"""Dialogues recorded from a Grbl 1.1h: its firmware, run in a simulator of its processor.

Each entry is what was sent and what came back before the next was sent. The simulator ran slower than the real thing,
so numbers of moving axes are not compared; where its reply to a line came after the next byte was sent, it stands here
with its line. Reports of the second recording named all input pins (``Pn:``), because the simulator leaves them
floating; they are left out.
"""

from __future__ import annotations

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = b"[MSG:'$H'|'$X' to unlock]\r\n"
SETTINGS = (
    b"$0=10\r\n$1=25\r\n$2=0\r\n$3=0\r\n$4=0\r\n$5=0\r\n$6=0\r\n$10=1\r\n$11=0.010\r\n$12=0.002\r\n$13=0\r\n"
    b"$20=0\r\n$21=0\r\n$22=0\r\n$23=0\r\n$24=25.000\r\n$25=500.000\r\n$26=250\r\n$27=1.000\r\n$30=1000\r\n$31=0\r\n"
    b"$32=0\r\n$100=250.000\r\n$101=250.000\r\n$102=250.000\r\n$110=500.000\r\n$111=500.000\r\n$112=500.000\r\n"
    b"$120=10.000\r\n$121=10.000\r\n$122=10.000\r\n$130=200.000\r\n$131=200.000\r\n$132=200.000\r\nok\r\n"
)

# Parts of two recordings with the lines that the firmware knows; each begins with a reset of a Grbl with the settings.
# settings, then (pause before [s], sent, answered)
Recording = tuple[dict[str, float], list[tuple[float, bytes, bytes]]]

GREETING: Recording = (
    {},
    [
        (0.1, b"\x18", BANNER),
        (0.1, b"$I\n", b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n"),
        (0.1, b"$$\n", SETTINGS),
        (0.1, b"?", b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"),
        (0.1, b"$X\n", b"ok\r\n"),
    ],
)
SOFT_LIMIT: Recording = (
    {"20": 1, "22": 1},
    [
        (3.0, b"\x18", BANNER),
        (0.1, b"G90 G1 X1 F600\n", b"ALARM:2\r\n[MSG:Reset to continue]\r\n"),
        (0.5, b"?", b""),
        (2.0, b"$X\n", b""),
        (2.0, b"G21 G90\n", b""),
        (2.0, b"G1 X2 F600\n", b""),
        (0.4, b"?", b""),
        (0.4, b"?", b""),
        (1.0, b"G1 X999 F600\n", b""),
        (0.4, b"?", b""),
        (1.0, b"G1 X1\n", b""),
        (0.2, b"\x18", b"ok\r\n" + BANNER + LOCKED),
        (0.1, b"$X\n", b"[MSG:Caution: Unlocked]\r\nok\r\n"),
    ],
)
HOLD: Recording = (
    {"22": 1},
    [
        (0.1, b"G1X20F300\n", b"ok\r\n"),
        (0.0, b"!", b""),
        (0.0, b"?", b"<Hold:1|MPos:0.000,0.000,0.000|FS:54,0|WCO:0.000,0.000,0.000>\r\n"),
        (0.0, b"?", b"<Hold:1|MPos:0.000,0.000,0.000|FS:54,0|Ov:100,100,100>\r\n"),
        (0.0, b"\x18", b"ALARM:3\r\n" + BANNER + LOCKED),
        (0.1, b"?", b"<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"),
        (0.1, b"$X\n", b"[MSG:Caution: Unlocked]\r\nok\r\n"),
        (0.1, b"G999\n", b"error:20\r\n"),
        (0.1, b"FOO\n", b"error:2\r\n"),
    ],
)
MOTION: Recording = (
    {"20": 1, "22": 1, "100": 400, "110": 1800, "120": 500},
    [
        (3.0, b"\x18", BANNER),
        (0.1, b"G90 G1 X-1 F600\n", b"ok\r\n"),
        (0.0, b"?", b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"),
        (2.0, b"$X\n", b"ok\r\n"),
        (0.1, b"G21G90G94\n", b"ok\r\n"),
        (0.1, b"G1X-2F600\n", b"ok\r\n"),
        (0.0, b"?", b"<Idle|MPos:-1.000,0.000,0.000|FS:0,0|Ov:100,100,100>\r\n"),
        (0.03, b"?", b"<Run|MPos:-1.112,0.000,0.000|FS:114,0>\r\n"),
        (0.03, b"?", b"<Run|MPos:-1.450,0.000,0.000|FS:175,0>\r\n"),
        (0.03, b"?", b"<Run|MPos:-1.835,0.000,0.000|FS:79,0>\r\n"),
        (5.1, b"?", b"<Idle|MPos:-2.000,0.000,0.000|FS:0,0>\r\n"),
        (1.0, b"G1X-999F600\n", b"ALARM:2\r\n[MSG:Reset to continue]\r\n"),
        (2.0, b"?", b""),
        (0.5, b"G1X-1\n", b""),
        (2.0, b"$X\n", b""),
        (0.5, b"?", b""),
        (2.0, b"G1X-20F300\n", b""),
        (0.5, b"!", b""),
        (0.5, b"?", b""),
        (0.5, b"\x18", b"ok\r\n" + BANNER + LOCKED),
        (0.3, b"?", b"<Alarm|MPos:-2.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"),
        (2.0, b"$X\n", b"[MSG:Caution: Unlocked]\r\nok\r\n"),
        (0.0, b"?", b"<Idle|MPos:-2.000,0.000,0.000|FS:0,0|Ov:100,100,100>\r\n"),
    ],
)
