"""Options in messages: the library names them as its own parameters, the command line as its flags."""

import re

# flags that are not the parameter's name with dashes
FLAGS = {
    "R_d_start": "--start-rd",
    "R_s_start": "--start-rs",
    "allow_outside_px": "--allow-outside",
    "away": "--highlight-margin",
    "check": "--no-check-lights",
    "light_deg": "--light-tolerance",
    "limit": "--max-combinations",
    "lights": "--light",
    "objectives": "--objective",
    "patch_budget": "--patches",
    "pose_deg": "--pose-tolerance",
    "posture_step_deg": "--posture-step",
    "postures": "--posture",
    "rows": "--ranking-rows",
    "sigma_start": "--start-sigma",
    "step_deg": "--step",
}


def flag(name: str) -> str:
    """The flag of a library's option."""
    return FLAGS.get(name, f"--{name.replace('_', '-')}")


def with_flags(message: str) -> str:
    """A message of the library with the flags of the options that it names as: option 'name'."""
    return re.sub(r"option '(\w+)'", lambda match: flag(match[1]), message)
