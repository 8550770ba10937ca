"""Displays among the controllers of a rig file: their screens, and which lights they can show."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo

from lightopt.config import _fields as fields
from lightopt.config._fields import Complaint, Frozen, complaint, expecting
from lightopt.config._light import LightConfig

DISPLAY_DRIVERS = ("screen", "command")
MOST_SQUARE = 1.05  # ratio of a screen pixel's sides that is taken for a rounded size_mm

_Pixels = Annotated[int, Field(ge=1, le=16384)]
_Arguments = Annotated[tuple[fields.Text, ...], Field(strict=False, min_length=1, max_length=50)]


def _with_file(arguments: tuple[str, ...]) -> tuple[str, ...]:
    if not any("{file}" in argument for argument in arguments):
        raise complaint('no entry has the field {file}, the path of the picture; add "{file}"')
    return arguments


Monitor = Annotated[int, Field(ge=1, le=16), expecting("the number of a monitor, from 1 to 16")]
Command = Annotated[
    _Arguments, AfterValidator(_with_file), expecting('a program and its arguments, such as [show-picture, "{file}"]')
]


class PictureConfig(Frozen):
    """The screen of a display, for driver: screen and driver: command."""

    resolution_px: Annotated[
        tuple[_Pixels, _Pixels], fields.LIST, expecting("[width, height], two whole numbers from 1 to 16384")
    ]
    """Width and height of the screen as the computer has it, whose visible area is the light's size_mm [pixels]."""
    gamma: Annotated[float, Field(ge=0.5, le=5), expecting("a number from 0.5 to 5")] = 2.2
    """Response of the screen: its radiance is (level / 255)^gamma of the full one."""
    turn_deg: Annotated[Literal[0, 90, 180, 270], expecting("0, 90, 180 or 270")] = 0
    """How the screen is mounted, seen from the part: where its own upper edge is, turned clockwise from above [deg]."""
    mirrored: bool = False
    """Whether the part sees the screen's left and right swapped, as in a mirror or on a screen lit from behind."""
    settle_ms: Annotated[float, Field(ge=0, le=1000), expecting("milliseconds, from 0 to 1000")] = 50.0
    """From showing a picture until it is on the screen [ms]; timing.light_ms is waited for in addition."""

    @property
    def seen_px(self) -> tuple[int, int]:
        """Columns and rows as seen from the part, along u and v."""
        width, height = self.resolution_px
        return (height, width) if self.turn_deg % 180 else (width, height)


_OWNERS: Mapping[str, tuple[str, ...]] = {"monitor": ("screen",), "command": ("command",), "picture": DISPLAY_DRIVERS}
_MISSING = {
    "monitor": 'missing key "monitor": number of the monitor (or port: virtual to simulate it), for driver: screen',
    "command": 'missing key "command": program that shows a picture (or port: virtual to simulate it), for driver: '
    "command",
    "picture": 'missing key "picture": the screen, {resolution_px: [width, height]}, for driver: screen and command',
}


def check_key(value: Any, info: ValidationInfo) -> Any:
    """Check a key of a controller that only displays have, or that they lack."""
    key, driver = str(info.field_name), info.data.get("driver")
    owners = _OWNERS.get(key)
    if driver is None:
        return value
    if owners is None:
        if driver in DISPLAY_DRIVERS and value not in (None, "virtual"):
            raise complaint(f"a display has no {key}; leave this out (port: virtual simulates the display)")
    elif driver not in owners:
        if value is not None:
            only = " and ".join(f"driver: {owner}" for owner in owners)
            raise complaint(f"only for {only}, and the driver is {driver}; leave this out")
    elif value is None and (key == "picture" or info.data.get("port") != "virtual"):
        raise fields.absent(_MISSING[key], key)
    return value


def display_misfits(
    controllers: Mapping[str, object], channels: Mapping[str, object], lights: Sequence[LightConfig]
) -> Iterator[Complaint]:
    """Lights that a display cannot show, and pixels of screens that are not square."""
    known = {light.name: light for light in lights}
    shown: dict[str, LightConfig] = {}
    for name, entry in channels.items():
        controller, light = fields.mapping(entry).get("controller"), known.get(name)
        if light is None or not isinstance(controller, str):
            continue
        config = fields.mapping(controllers.get(controller))
        if config.get("driver") not in DISPLAY_DRIVERS:
            continue
        where = ("lights", name, "controller")
        if light.kind != "display":
            yield where, controller, complaint(f"{controller} is a display, and this light is a {light.kind}")
        elif shown.setdefault(controller, light).entry != light.entry:
            reason = (
                f"{controller} is the display {shown[controller].entry_name}; each display needs its own controller"
            )
            yield where, controller, complaint(reason)
    for controller, light in shown.items():
        picture = fields.mapping(fields.mapping(controllers[controller]).get("picture"))
        width, height = (light.size_mm or (1.0, 1.0))[:: -1 if picture.get("turn_deg") in (90, 270) else 1]
        pixels = fields.entries(picture.get("resolution_px"))
        if len(pixels) != 2 or not all(isinstance(one, int) and one > 0 for one in pixels):
            continue
        sides = width / pixels[0], height / pixels[1]  # type: ignore[operator]
        if max(sides) > MOST_SQUARE * min(sides):
            reason = (
                f"on the {width:g} × {height:g} mm of {light.entry_name} a pixel of the screen would have "
                f"{sides[0]:.4g} × {sides[1]:.4g} mm; expected square ones: correct this, turn_deg, or the light's "
                "size_mm, which is the visible area"
            )
            yield ("controllers", controller, "picture", "resolution_px"), list(pixels), complaint(reason)
