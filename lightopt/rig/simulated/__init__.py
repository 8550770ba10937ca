"""The virtual bench: simulated firmware on wires, and a camera that sees what the firmware does.

A new device is a module ``_light_NAME.py`` or ``_stage_NAME.py`` as ``_firmware.py`` says, and a line there. It must
not import the driver, nor the driver it: the two meet on the wire only.

``BenchProcess`` (``_bench_process.py``) is the bench from outside; in its process ``_host.py`` serves the devices
(``_devices.py``) on their wires, and answers requests.
"""

from lightopt.rig.simulated._bench_process import (
    CAMERA as CAMERA,
    EXPOSURE_RANGE_US as EXPOSURE_RANGE_US,
    AxisWire as AxisWire,
    BenchProcess as BenchProcess,
    BenchTruth as BenchTruth,
    CameraSetup as CameraSetup,
    LightWire as LightWire,
)
