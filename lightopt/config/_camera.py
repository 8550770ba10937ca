"""The camera in a rig file: its geometry, its sensor, and the device behind it."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from lightopt.config import _fields as fields
from lightopt.config._fields import LIST, Frozen, expecting
from lightopt.config._pose import CameraPoseConfig, with_pose
from lightopt.config._yaml_file import load_file
from lightopt.core.errors import InputError

_Distortion = Annotated[float, Field(ge=-1e3, le=1e3), expecting("a number")]
_Pixels = Annotated[int, Field(ge=1, le=65535)]
_Nanoseconds = Annotated[int, Field(ge=0, le=1000000000), expecting("nanoseconds, from 0 to 1000000000")]
_Pixel = Annotated[int, Field(ge=0, le=65535), expecting("pixels, from 0 to 65535")]
_Offset = Annotated[tuple[_Pixel, _Pixel], LIST, expecting("two whole numbers of pixels, [left, top]")]
_PacketSize = Annotated[int, Field(ge=576, le=65535), expecting("bytes, from 576 to 65535")]


def _whole(value: object) -> object:
    if type(value) is not int:
        raise ValueError("a literal would take 8.0 for 8")
    return value


_Point = Annotated[tuple[fields.Number, fields.Number], LIST, expecting("[column, row], two numbers of pixels")]
_Focal = Annotated[tuple[fields.Positive, fields.Positive], LIST, expecting("[columns, rows], two numbers above 0")]


class DistortionConfig(Frozen):
    """Lens distortion in OpenCV's model: x to the right, y down, in units of the image distance."""

    k1: _Distortion = 0.0
    """Radial coefficient of r²."""
    k2: _Distortion = 0.0
    """Radial coefficient of r⁴."""
    p1: _Distortion = 0.0
    """First tangential coefficient."""
    p2: _Distortion = 0.0
    """Second tangential coefficient."""
    k3: _Distortion = 0.0
    """Radial coefficient of r⁶."""


_LEAST_SHARE = 0.05  # of the light, that a lens lets through
_Dimming = Annotated[float, Field(ge=-0.9, le=1.0), expecting("a number from -0.9 to 1")]


class VignettingConfig(Frozen):
    """How the lens dims the image away from the optical axis: by the factor 1 + v2·ρ² + v4·ρ⁴."""

    v2: _Dimming = 0.0
    """Coefficient of ρ², ρ the distance from the principal point in half diagonals."""
    v4: _Dimming = 0.0
    """Coefficient of ρ⁴."""
    cos4: bool = False
    """Whether the fourth power of the cosine to the optical axis dims the image as well, as with a simple lens."""

    @fields.rule("v4")
    def _lit_everywhere(cls, v4: float, info: ValidationInfo) -> Iterator[fields.Fault]:
        v2: float = info.data.get("v2", 0.0)
        least = 1.0 + v2 + v4  # in the corners; where these coefficients have a minimum nearer, it is 0.55 or more
        if least < _LEAST_SHARE:
            factor = f"with v2 = {v2:g}, 1 + v2·ρ² + v4·ρ⁴ is {least:.3g} in the corners"
            yield f"{factor}; expected at least {_LEAST_SHARE:g} of the light everywhere"


_Electrons = Annotated[float, Field(ge=0, le=1e6), expecting("electrons, from 0 to 1e6")]
_Percent = Annotated[float, Field(ge=0, le=50), expecting("per cent, from 0 to 50")]
_Efficiency = Annotated[float, Field(gt=0, le=100), expecting("per cent, above 0 up to 100")]


class SensorSheetConfig(fields.FileConfig):
    """The data sheet of a sensor by EMVA Standard 1288, release 4.0, in the standard's units."""

    format: Literal["lightopt-sensor/1"]
    """Kind and version of this file: lightopt-sensor/1."""
    name: fields.Text
    """Name of the sensor, for people."""
    quantum_efficiency_percent: _Efficiency
    """Quantum efficiency η at the wavelength of the light [%]."""
    saturation_capacity_e: Annotated[float, Field(ge=1, le=1e9), expecting("electrons, from 1 to 1e9")]
    """Saturation capacity μe.sat [electrons]."""
    dark_noise_e: _Electrons
    """Temporal dark noise σd [electrons]."""
    levels_per_electron: fields.Positive | None = None
    """System gain K at the rig's bit depth and gain [levels per electron]; if absent, such that the saturation capacity
    makes the saturation level."""
    dark_current_e_per_s: Annotated[float, Field(ge=0, le=1e9), expecting("electrons per second")] = 0.0
    """Dark current μI [electrons per second]."""
    dsnu_e: _Electrons = 0.0
    """Dark signal non-uniformity DSNU1288 [electrons]."""
    prnu_percent: _Percent = 0.0
    """Photo response non-uniformity PRNU1288 [%]."""
    linearity_error_percent: Annotated[float, Field(ge=0, le=10), expecting("per cent, from 0 to 10")] = 0.0
    """Linearity error LE [%]."""


class SensorConfig(Frozen):
    """How the sensor turns light into levels."""

    bit_depth: Annotated[Literal[8, 10, 12, 14, 16], BeforeValidator(_whole), expecting("8, 10, 12, 14 or 16")]
    """Bits per pixel: 8, 10, 12, 14 or 16. The full scale is 2^bits - 1 levels."""
    saturation_level: Annotated[int, Field(ge=1), expecting("a whole level above 0")] | None = None
    """Level [levels] from which a pixel is saturated; the full scale unless given. Some 12-bit cameras stop at 4080."""
    black_level: Annotated[float, Field(ge=0), expecting("a level from 0 up")] = 0.0
    """Level of an unlit pixel [levels of the sensor]."""
    read_noise_levels: Annotated[float, Field(ge=0, le=1e5), expecting("a number from 0 up")] = 0.0
    """Standard deviation of the noise without light [levels of the sensor]."""
    electrons_per_level: fields.Positive | None = None
    """Conversion gain [electrons per level], for shot noise; none unless given."""
    quantum_efficiency_percent: _Efficiency | None = None
    """Quantum efficiency [%], with which lightopt check states photons; it changes no image."""
    dark_current_e_per_s: Annotated[float, Field(ge=0, le=1e9), expecting("electrons per second")] = 0.0
    """Dark current [electrons per second], whose noise in exposure_us is added to the read noise."""
    dsnu_levels: Annotated[float, Field(ge=0, le=1e5), expecting("a number from 0 up")] = 0.0
    """Standard deviation over the pixels of the level without light [levels of the sensor]."""
    prnu_percent: Annotated[float, Field(ge=0, le=50), expecting("per cent, from 0 to 50")] = 0.0
    """Standard deviation over the pixels of what they make of the same light [%]."""
    linearity_error_percent: Annotated[float, Field(ge=0, le=10), expecting("per cent, from 0 to 10")] = 0.0
    """Linearity error by EMVA 1288: mean deviation from the best line, of levels that rise less and less [%]."""
    data_sheet: fields.Text | None = None
    """Data sheet by EMVA 1288 (lightopt-sensor/1), for the keys above that are absent; relative to this file."""

    @model_validator(mode="wrap")
    @classmethod
    def _with_sheet(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        file = fields.value_of(value, "data_sheet")
        sheet, wrong = None, list[fields.Complaint]()
        if isinstance(file, str) and info.context:
            try:
                sheet = load_file(info.context["folder"] / file, SensorSheetConfig, "lightopt-sensor/1")
            except InputError as error:
                wrong.append((("data_sheet",), "; ".join(error.messages)))
        own = fields.with_complaints(value, handler, wrong)
        if sheet is None:
            return own
        top = (own.saturation_level or 2**own.bit_depth - 1) - own.black_level
        given = own.electrons_per_level or 1.0 / (sheet.levels_per_electron or top / sheet.saturation_capacity_e)
        found = {
            "electrons_per_level": given,
            "quantum_efficiency_percent": sheet.quantum_efficiency_percent,
            "read_noise_levels": sheet.dark_noise_e / given,
            "dark_current_e_per_s": sheet.dark_current_e_per_s,
            "dsnu_levels": sheet.dsnu_e / given,
            "prnu_percent": sheet.prnu_percent,
            "linearity_error_percent": sheet.linearity_error_percent,
        }
        return own.model_copy(update={key: number for key, number in found.items() if key not in own.model_fields_set})

    @fields.rule("saturation_level")
    def _within_full_scale(cls, level: int | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        bits = info.data.get("bit_depth")
        if level is not None and bits is not None and level > 2**bits - 1:
            yield f"expected at most {2**bits - 1}, the full scale of {bits} bits, found {level}"

    @fields.rule("black_level")
    def _below_saturation(cls, black: float, info: ValidationInfo) -> Iterator[fields.Fault]:
        if "bit_depth" not in info.data or "saturation_level" not in info.data:
            return
        top = info.data["saturation_level"] or 2 ** info.data["bit_depth"] - 1
        if black >= top:
            yield f"expected less than the saturation level, {top}, found {black:g}"


class CameraConfig(Frozen):
    """A pinhole camera that looks at the origin, the centre of the table top, or has a measured pose."""

    one_of = ("image_distance_mm", "focal_length_mm", "focal_px")

    distance_mm: fields.Length
    """Distance from the origin to the pinhole [mm]."""
    elevation_deg: fields.Elevation
    """Elevation of the camera above the table plane [deg]; 90 is straight above."""
    azimuth_deg: fields.Azimuth = 270.0
    """Azimuth of the camera about Z, from X [deg]; at 270 and elevation 90 the image shows X to the right and Y up."""
    roll_deg: fields.Azimuth = 0.0
    """Roll of the camera about its viewing axis [deg]."""
    pose: CameraPoseConfig | None = None
    """Measured pose, in place of distance_mm, elevation_deg, azimuth_deg and roll_deg."""
    resolution_px: Annotated[tuple[_Pixels, _Pixels], LIST, expecting("[width, height], whole numbers up to 65535")]
    """Width and height of the image [pixels]."""
    pixel_size_um: Annotated[float, Field(ge=0.01, le=1000), expecting("a number from 0.01 to 1000")]
    """Edge of a square pixel on the sensor [µm]."""
    principal_point_px: _Point | None = None
    """Column and row where the optical axis meets the image [pixels]; the first pixel's centre is at 0.5, 0.5. The
    image's centre if absent."""
    focal_px: _Focal | None = None
    """Measured focal length in columns and in rows [pixels]. Give this, image_distance_mm or focal_length_mm."""
    image_distance_mm: fields.Length | None = None
    """Distance from the pinhole to the image plane [mm]. Give this or focal_length_mm."""
    focal_length_mm: fields.Length | None = None
    """Focal length of a lens focused at focus_distance_mm [mm]: 1/f = 1/a + 1/b. Give this or image_distance_mm."""
    aperture: Annotated[float, Field(ge=0.5, le=1000), expecting("an f-number from 0.5 to 1000")] | None = None
    """F-number, focal length over diameter of the aperture. If absent, the camera is a pinhole: all is in focus."""
    focus_distance_mm: fields.Length | None = None
    """Distance along the optical axis from the pinhole to the plane in focus [mm]; distance_mm if absent."""
    wavelength_nm: Annotated[float, Field(ge=100, le=20000), expecting("nanometres, from 100 to 20000")] | None = None
    """Wavelength of the light, for diffraction at the aperture [nm]; no diffraction if absent."""
    distortion: DistortionConfig = DistortionConfig()
    """Lens distortion; none unless given."""
    vignetting: VignettingConfig | None = None
    """Measured vignetting; none unless given."""
    sensor: SensorConfig
    """The sensor, and how it turns light into levels."""
    exposure_us: fields.Positive | None = None
    """Exposure time [µs] that counts as exposure 1, on real hardware and of a part that moves."""

    @model_validator(mode="wrap")
    @classmethod
    def _placed(cls, value: object, handler: fields.Handler) -> Any:
        return with_pose(value, handler, point="position_mm", what="the camera", also=("roll_deg",))

    @fields.rule("focal_length_mm")
    def _in_front(cls, focal: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        distance = info.data.get("distance_mm")
        if focal is not None and distance is not None and focal >= distance:
            yield f"expected less than distance_mm, {distance:g}: a lens of {focal:g} mm cannot focus there"

    @fields.rule("focus_distance_mm", "wavelength_nm")
    def _of_a_lens(cls, value: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if value is not None and info.data.get("aperture", 0.0) is None:
            yield "only a lens with an aperture has this; give aperture (its f-number), too"
        focal = info.data.get("focal_length_mm")
        if value is not None and info.field_name == "focus_distance_mm" and focal is not None and value <= focal:
            yield f"expected more than focal_length_mm, {focal:g}, found {value:g}: it cannot focus there"


_OF_MACHINE_CAMERAS = ("port", "pixel_format", "offset_px", "gain", "trigger", "fixed_exposure_us")


class CameraDeviceConfig(Frozen):
    """The device that takes the images."""

    variants = fields.Variants(
        "driver",
        {
            "virtual": ((), ()),
            "folder": (("folder",), ()),
            "aravis": ((), (*_OF_MACHINE_CAMERAS, "packet_size", "packet_delay_ns")),
            "genicam": (("producer",), _OF_MACHINE_CAMERAS),
        },
        usual={"trigger": "auto"},
    )

    driver: Literal["virtual", "folder", "aravis", "genicam"] = "virtual"
    """virtual: frames rendered by the virtual bench; folder: frames replayed; aravis: GigE Vision and USB3 Vision
    cameras; genicam: any camera, through its maker's GenTL producer."""
    folder: fields.Text | None = None
    """folder: an image set whose PNG files are replayed; relative to this file."""
    port: fields.Text | None = None
    """aravis, genicam: serial number, address or identifier of the camera, in quotes, as lightopt bench devices lists
    it; if absent, the only camera that answers. aravis: virtual is a GigE Vision camera simulated on this computer."""
    producer: fields.Text | None = None
    """genicam: the maker's GenTL producer, a .cti file; relative to this file."""
    pixel_format: fields.Text | None = None
    """aravis, genicam: pixel format, such as Mono12p; one that has the sensor's bit_depth if absent."""
    offset_px: _Offset | None = None
    """aravis, genicam: where the image begins on the sensor, from left and top [pixels]; centred if absent."""
    gain: Annotated[float, Field(ge=-100, le=1000), expecting("a gain")] | None = None
    """aravis, genicam: gain in the camera's own units, mostly dB; as the camera has it if absent."""
    trigger: Literal["auto", "software", "none"] = "auto"
    """aravis, genicam: software: each frame is triggered; none: the camera is free-running and timing.discard_frames
    are discarded after each change; auto: software where the camera has it."""
    fixed_exposure_us: fields.Positive | None = None
    """aravis, genicam: exposure time [us] of a camera on which it cannot be set."""
    packet_size: _PacketSize | None = None
    """aravis: size of a camera's packets on the network [bytes]; as it is if absent."""
    packet_delay_ns: _Nanoseconds | None = None
    """aravis: pause between a camera's packets [ns]; as it is if absent."""

    @fields.rule("port")
    def _not_simulated(cls, port: str | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if port == "virtual" and info.data.get("driver") == "genicam":
            yield "only driver: aravis has a simulated camera (or driver: virtual)"

    @property
    def is_simulated(self) -> bool:
        """Whether the virtual bench renders its frames."""
        return self.driver == "virtual" or (self.driver == "aravis" and self.port == "virtual")
