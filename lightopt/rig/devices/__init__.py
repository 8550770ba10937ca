"""Devices of a rig in three roles: light controller, stage, camera. One module per protocol.

A new driver is a module ``_light_NAME.py``, ``_stage_NAME.py`` or ``_camera_NAME.py``, and a line in ``_drivers.py``:

- light: derives from ``LightController`` (``_light.py``);
- stage: a ``Dialogue``, with which ``Stage`` (both in ``_stage.py``) moves, watches and verifies;
- camera: a ``CameraSdk`` (``_camera_sdk.py``), with which ``MachineCamera`` (``_camera.py``) sets, triggers and checks.

Its simulated counterpart is the module of the same name in ``lightopt.rig.simulated``. Drivers have a ``SerialLink``
(``_serial_link.py``), the one home of pyserial. Aravis and harvesters are loaded when a camera is searched for.
"""

from ._camera import Camera, Frame
from ._camera_features import Levels
from ._camera_sdk import CameraInfo, CameraSettings
from ._device import Event, frame_limit_s, now
from ._drivers import LIGHT_DRIVERS, STAGE_DRIVERS, check_camera_driver, find_cameras, open_camera, open_stage
from ._light import LightController, LightSettings, LightsStillOnError, all_off, run_in_parallel
from ._light_display import check_display
from ._serial_link import SerialLog
from ._serial_ports import port_problem, serial_ports
from ._stage import Axis, Stage, StageState
