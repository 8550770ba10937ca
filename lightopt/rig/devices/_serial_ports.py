"""The serial ports that this computer has, and why one cannot be opened."""

import errno
import re
from dataclasses import dataclass
from pathlib import Path

from lightopt.core.errors import HardwareError, InputError, LightoptError


@dataclass(frozen=True)
class Port:
    """A serial port of this computer; `usb` is ``vendor:product serial`` in hexadecimal digits, empty without USB."""

    name: str
    description: str
    usb: str = ""


def serial_ports() -> tuple[Port, ...]:
    """List the serial ports, with their stable names (``/dev/serial/by-id/…``); nothing is opened or written."""
    from serial.tools.list_ports import comports

    ports: list[Port] = []
    for port in sorted(comports(include_links=True), key=lambda p: p.device):
        usb = ""
        if port.vid is not None:
            usb = f"{port.vid:04x}:{port.pid:04x}" + (f" {port.serial_number}" if port.serial_number else "")
        description = "" if port.description in (None, "n/a") else str(port.description)
        ports.append(Port(str(port.device), description, usb))
    return tuple(ports)


def port_problem(port: str) -> str | None:
    """Why a name can be no port of this computer; None where it is one, or a URL, which shows when it is opened."""
    there = [known.name for known in serial_ports()]
    if "://" in port or port in there:
        return None
    path = Path(port)
    if not path.exists():
        are = f"there {'is' if len(there) == 1 else 'are'} {', '.join(there) or 'none'}"
        return f"no port {port} on this computer; {are}"
    if not path.is_char_device():
        return f"{port} is not a serial port, but a {'folder' if path.is_dir() else 'file'}"
    return None


def cannot_open(port: str, device: str, error: BaseException) -> LightoptError:
    """Why a port could not be opened: HardwareError where it is in use or out of reach, else InputError."""
    reason = str(error)
    number = getattr(error, "errno", None)
    head = f"{device}: port {port}"
    if "exclusively lock" in reason or number == errno.EBUSY or "Access is denied" in reason:
        return HardwareError(f"{head} is in use by another program; close it, or wait for it to end")
    if number == errno.EACCES or "Permission denied" in reason:
        return InputError(f"{head} may not be opened by this user; on Linux: add the user to its group (dialout)")
    if port.startswith(("socket://", "rfc2217://")):
        if re.fullmatch(r"\w+://[^/]+:\d+.*", port) is None:
            return InputError(f"{head} names no host and number; expected {port.partition(':')[0]}://host:number")
        advice = "check address and network, that the device is on, and that no other program holds its one connection"
        return HardwareError(f"{head} cannot be reached: {_short(reason)}; {advice}")
    if isinstance(error, ValueError):
        return InputError(f"{head} is not a port or URL that can be opened: {_short(reason)}")
    if (problem := port_problem(port)) is not None and "is not a serial port" in problem:
        return InputError(f"{device}: {problem}")
    there = ", ".join(p.name + (f" ({p.description})" if p.description else "") for p in serial_ports())
    return InputError(f"{head} cannot be opened: {_short(reason)}; ports on this computer: {there or 'none'}")


def _short(reason: str) -> str:
    return reason.partition("] ")[2] or reason if reason.startswith("[Errno") else reason
