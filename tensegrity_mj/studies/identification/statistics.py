"""What a fit says of its parameters: linear statistics of residuals and their Jacobian, and nothing of simulations.

Residuals are (measured - predicted) / σ, (n,); the Jacobian J (n, P) is that of predictions / σ by the parameters, each
in parts of its size. Jᵀ J is the Fisher information of independent normal noise.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics.arrays import Array

LIMIT = 1.0  # of the parameters' sizes: a combination that data leave more uncertain than this is not seen
MOST_LAGS, SAMPLES_A_LAG = 10, 5  # Hyndman and Athanasopoulos, Forecasting: Principles and Practice, 3rd ed., 5.4
LEAST = 0.02  # of a combination's largest part: smaller ones are not named
FEWEST = 20  # samples of a series whose correlation in time is looked at


class Information(NamedTuple):
    """What data determine.

    Attributes:
        eigenvalues: (P,) of the Fisher information, rising.
        unseen: (K, P) combinations that they do not see, each with 1 at a parameter of its own, `pivots`.
        deviations: (K,) of these combinations, in parts of the parameters' sizes; infinite where nothing is seen.
        pivots: (K,) parameters without which all else is seen.
    """

    eigenvalues: Array
    unseen: Array
    deviations: Array
    pivots: tuple[int, ...]

    def words(self, names: list[str]) -> list[str]:
        """Combinations that are not seen, as changes in parts of the parameters' sizes."""
        found = []
        for row, deviation in zip(self.unseen, self.deviations, strict=True):
            named = np.flatnonzero(np.abs(row) > LEAST * np.abs(row).max())
            part = row / np.abs(row).max() * np.sign(row[named[0]])
            parts = [f"{part[k]:+.2g} {names[k]}" for k in named] if len(named) > 1 else [names[named[0]]]
            known = "at all" if np.isinf(deviation) else f"better than ± {deviation:.2g} of its size"
            found.append(f"{', '.join(parts)} ({known})")
        return found

    def told(self, names: list[str]) -> dict[str, Any]:
        """All of it as plain values."""
        condition = float("nan")  # of no parameters
        if len(self.eigenvalues):
            low, high = self.eigenvalues[0], self.eigenvalues[-1]
            condition = float(high / low) if low > 0 else float("inf")
        return {"eigenvalues": self.eigenvalues.tolist(), "condition": condition, "unseen": self.words(names)}


def information(jacobian: Array, noise: float, limit: float = LIMIT) -> Information:
    """The information in a Jacobian (n, P), known to `noise` of its largest singular value.

    A combination is not seen where its standard deviation, 1 / singular value, is above `limit`, or where its singular
    value is below the noise.
    """
    from scipy.linalg import qr

    count = jacobian.shape[1]
    _, found, rows = np.linalg.svd(jacobian, full_matrices=len(jacobian) < count)
    values = np.zeros(count)
    values[: len(found)] = found
    floor = noise * values.max(initial=0.0)
    weak = (values <= floor) | (values < 1.0 / limit)
    basis = rows[weak]
    pivots: tuple[int, ...] = ()
    if len(basis):
        pivots = tuple(int(one) for one in np.sort(qr(basis, pivoting=True, mode="economic")[2][: len(basis)]))
        basis = np.linalg.solve(basis[:, pivots], basis)
    sizes = np.linalg.norm(jacobian @ basis.T, axis=0) / np.linalg.norm(basis, axis=1)
    deviations = np.where(sizes > floor, 1.0 / np.maximum(sizes, 1e-300), np.inf)
    return Information(np.sort(values**2), basis, deviations, pivots)


def held_back(jacobian: Array, noise: float, limit: float = LIMIT) -> list[int]:
    """The parameters without which all others are seen: pivots, until nothing is left that is not."""
    free = list(range(jacobian.shape[1]))
    while free and (found := information(jacobian[:, free], noise, limit)).pivots:
        free = [one for place, one in enumerate(free) if place not in found.pivots]
    return [one for one in range(jacobian.shape[1]) if one not in free]


def covariance(jacobian: Array, noise: float) -> Array:
    """(Jᵀ J)⁻¹, (P, P); the variances of parameters in a combination that nothing is known of are infinite."""
    _, values, rows = np.linalg.svd(jacobian, full_matrices=False)
    seen = values > noise * values.max(initial=0.0)
    scaled = rows[seen] / values[seen, None]
    found = scaled.T @ scaled
    lost = 1.0 - np.sum(rows[seen] ** 2, axis=0) > 1e-8
    found[lost, lost] = np.inf
    return found


def correlation(covariances: Array) -> Array:
    """(P, P) from covariances; NaN where a variance is infinite or zero."""
    deviations = np.sqrt(np.diag(covariances))
    with np.errstate(invalid="ignore", divide="ignore"):
        found = covariances / np.outer(deviations, deviations)
    found[~np.isfinite(found)] = np.nan
    return found


def whiteness(series: list[Array]) -> dict[str, Any]:
    """Whether residuals are free of correlation in time, of series of them in the order of their times.

    Autocorrelations ρ_k of one of T samples have about the variance 1/T. Ljung and Box (1978), Biometrika 65, 297:
    T (T + 2) Σ ρ_k² / (T - k), k = 1 ... h, is χ² of h degrees of freedom; here summed over the series, whose noise is
    independent. What the fit takes of it is left out: it has far fewer parameters than there are samples.
    """
    from scipy.stats import chi2

    used = [one for one in series if len(one) >= FEWEST and np.any(one)]
    if not used:
        return {"lags": 0, "autocorrelation": [], "bound": None, "statistic": None, "p_value": None}
    lags = min(MOST_LAGS, min(map(len, used)) // SAMPLES_A_LAG)
    rho = np.array([[one[k:] @ one[:-k] / (one @ one) for k in range(1, lags + 1)] for one in used])
    sizes = np.array([len(one) for one in used], float)[:, None]
    statistic = float(np.sum(sizes * (sizes + 2) * rho**2 / (sizes - np.arange(1, lags + 1))))
    return {
        "lags": lags,
        "autocorrelation": (np.sum(sizes * rho, axis=0) / sizes.sum()).tolist(),
        "bound": float(1.96 / np.sqrt(sizes.sum())),
        "statistic": statistic,
        "p_value": float(chi2.sf(statistic, lags * len(used))),
    }
