"""Where each parameter of a fit is in the vector of parameters, and the coefficients in such a vector."""

import math

from lightopt.core.arrays import Float64

# places in the vector of parameters: R_d, ln R_s, ln σ, dark level, then ln gain per light, ln τ², logit ε
R_D, LOG_R_S, LOG_SIGMA, DARK, FIRST_GAIN = 0, 1, 2, 3, 4


class Coefficients:
    """R_d, R_s and σ in a vector of parameters."""

    x: Float64  # shape (K,)

    @property
    def R_d(self) -> float:  # noqa: N802
        """[grey level]."""
        return float(self.x[R_D])

    @property
    def R_s(self) -> float:  # noqa: N802
        """[grey level]."""
        return math.exp(self.x[LOG_R_S])

    @property
    def sigma(self) -> float:
        """[rad]."""
        return math.exp(self.x[LOG_SIGMA])


def outlier_share(x: Float64) -> float:
    """Share ε of the pixels that a vector of parameters takes for dust, glints and the like."""
    return 1.0 / (1.0 + math.exp(-x[-1]))


def parameter_name(place: int, lights: tuple[str, ...]) -> str:
    gains = (f"the gain of {light}" for light in lights)
    noise = ("the deviation beside the noise", "the share of outliers")
    return ("R_d", "R_s", "σ", "the dark level", *gains, *noise)[place]


def significant(value: float | None, digits: int) -> float | None:
    """A number for a file, with so many significant digits."""
    return None if value is None else float(f"{value:.{digits}g}")
