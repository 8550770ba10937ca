"""The virtual bench: simulated firmware on wires, and a camera that sees what the firmware does.

A new device is a module ``_light_NAME.py`` or ``_stage_NAME.py`` as ``_firmware.py`` says, and a line there. It must
not import the driver, nor the driver it: the two meet on the wire only.

``BenchProcess`` (``_bench_process.py``) is the bench from outside; in its process ``_host.py`` serves the devices
(``_devices.py``) on their wires, and answers requests.
"""

from ._bench_process import CAMERA, EXPOSURE_RANGE_US, AxisWire, BenchProcess, BenchTruth, CameraSetup, LightWire
