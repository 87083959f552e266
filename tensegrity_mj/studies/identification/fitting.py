"""A fit by least squares: what data see of the parameters before it; estimates, intervals and residuals after it.

Statistics are linear, of residuals and their Jacobian. Residuals are (measured - predicted) / σ, (n,); the Jacobian J
(n, P) is that of predictions / σ by the parameters, each in parts of its size. Jᵀ J is the Fisher information of
independent normal noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array, IntArray
from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.errors import DivergenceError, IdentificationWarning, OptionError, TensegrityError
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.studies.identification.measurements import Observation
from tensegrity_mj.studies.identification.predictions import Predictions, StoredPredictions
from tensegrity_mj.studies.identification.unknowns import Unknowns

Data = dict[str, Any]
TOLERANCE = 1e-8  # relative change of parameters or of the sum of squares: of n numbers, √(n 1e-8) deviations are left
MOST_RUNS = 200


@value("FitOptions", OptionError)
class FitOptions:
    """Options of a fit.

    Attributes:
        level: of the intervals' confidence.
        hold_unseen: whether parameters without which the data see all others stay at their start.
        actuation: of the law; continuous by default.
    """

    level: float = field(kinds.number("between 0 and 1", lambda x: 0 < x < 1), default=0.95)
    hold_unseen: bool = field(kinds.flag(), default=False)
    actuation: Actuation | None = field(None, default=None)


@dataclass(frozen=True, eq=False)
class Problem:
    """Residuals (predicted - measured) / σ, then (value - start) / prior, by parameters in parts of their sizes."""

    model: Predictions | StoredPredictions
    unknowns: Unknowns
    observation: Observation

    def residuals(self, parts: Array) -> Array:
        """(n + K,) of n measurements and K priors."""
        unknowns, observed = self.unknowns, self.observation
        values, known = parts * unknowns.sizes, ~np.isnan(unknowns.prior)
        off = (self.model.predict(values) - observed.values) / observed.sigma
        return np.concatenate([off, ((values - unknowns.start) / unknowns.prior)[known]])

    def jacobian(self, parts: Array) -> Array:
        """(n + K, P)."""
        sizes, known = self.unknowns.sizes, ~np.isnan(self.unknowns.prior)
        slopes = self.model.jacobian(parts * sizes) * (sizes / self.observation.sigma[:, None])
        return np.concatenate([slopes, np.diag(sizes / self.unknowns.prior)[known]])


def fit(problem: Problem, options: FitOptions, progress: bool = False) -> Data:
    """Fit the parameters; returns plain values, with parameters in their order.

    SciPy's trust region (`least_squares`, "trf") makes the sum of squares least within the bounds. Where no noise is
    given, σ is one, and is estimated afterwards.

    Warns:
        IdentificationWarning: before the fit, of combinations of parameters that the data do not see.

    Raises:
        OptionError: where the data see no parameter.
        TensegrityError: where the start cannot be simulated.
    """
    from scipy.optimize import least_squares

    unknowns, noise = problem.unknowns, problem.model.noise
    start, limit = unknowns.start / unknowns.sizes, LIMIT if problem.observation.known else np.inf
    with bar(progress, f"fit of {len(start)} parameters", unit=" runs") as steps:
        slopes = problem.jacobian(start)
        if not (np.isfinite(problem.residuals(start)).all() and np.isfinite(slopes).all()):
            raise DivergenceError("the run with the parameters' starts is not finite; start elsewhere", 0.0)
        before = information(slopes, noise, limit)
        held = held_back(slopes, noise, limit) if options.hold_unseen else []
        free = np.setdiff1d(np.arange(len(start)), held)
        if before.pivots:
            done = f"; held at their starts: {', '.join(unknowns.names[k] for k in held)}" if held else ""
            warning = f"the measurements do not see: {'; '.join(before.combinations(unknowns.names))}{done}"
            if not len(free):
                raise OptionError(warning)
            warn_caller(warning, IdentificationWarning)
        if not problem.observation.known and len(slopes) <= len(free):
            raise OptionError(
                f"measurements: {len(slopes)} numbers do not determine {len(free)} parameters and the noise as well; "
                "give more, or the noise, as measured(..., nodes=1e-3)"
            )

        def whole(parts: Array) -> Array:
            found = start.copy()
            found[free] = parts
            return found

        def residuals(parts: Array) -> Array:
            steps.update()
            try:
                return problem.residuals(whole(parts))
            except TensegrityError:  # the step was too long for the scene: a shorter one follows
                return np.full(len(slopes), np.nan)

        found = least_squares(
            residuals,
            start[free],
            lambda parts: problem.jacobian(whole(parts))[:, free],
            ((unknowns.low / unknowns.sizes)[free], (unknowns.high / unknowns.sizes)[free]),
            x_scale="jac",
            max_nfev=MOST_RUNS,
            **dict.fromkeys(("xtol", "ftol", "gtol"), TOLERANCE),
        )
    inner, values = found.active_mask == 0, whole(found.x) * unknowns.sizes
    notes = np.full(len(start), "held at its start", object)
    notes[free] = np.where(inner, "", "at its bound")
    known, deviations, reach = _known(problem, found.jac[:, inner], found.fun, free[inner], options.level)
    columns = {"name": unknowns.names, "path": unknowns.paths, "start": unknowns.start, "value": values}
    columns |= {"deviation": deviations, "low": values - reach, "high": values + reach, "note": notes}
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    return {
        "parameters": [dict(zip(columns, row, strict=True)) for row in rows],
        "converged": bool(found.status > 0),
        "runs": int(found.nfev),
        "before": before.to_dict(unknowns.names),
        **known,
        **_series(problem.observation, found.fun),
    }


def _known(
    problem: Problem, jacobian: Array, residuals: Array, inner: IntArray, level: float
) -> tuple[Data, Array, Array]:
    """Return how well the parameters `inner` are known: data, deviations and half intervals (P,), NaN of the others.

    With noise that is given the covariance is (Jᵀ J)⁻¹ and intervals are normal. Else it is times the variance of the
    noise, estimated as χ² / (n + K - P), and intervals are Student's t of that many degrees of freedom.
    """
    from scipy.stats import chi2, norm, t

    observed, names = problem.observation, [problem.unknowns.names[k] for k in inner]
    degrees, total = len(residuals) - len(inner), float(residuals @ residuals)
    variance = 1.0 if observed.known else total / degrees if degrees > 0 else np.nan
    found = covariance(jacobian, problem.model.noise) * variance
    deviations = np.full(len(problem.unknowns.start), np.nan)
    deviations[inner] = np.sqrt(np.diag(found)) * problem.unknowns.sizes[inner]
    quantile = (norm if observed.known else t(max(degrees, 1))).ppf(0.5 + 0.5 * level)
    data = {
        "level": level,
        "estimated_noise": None if observed.known else float(np.sqrt(variance)),
        "chi_squared": total if observed.known else None,
        "degrees": degrees,
        "p_value": float(chi2.sf(total, degrees)) if observed.known and degrees > 0 else None,
        "correlated": names,
        "correlation": correlation(found).tolist(),
        "after": information(jacobian / np.sqrt(variance or 1.0), problem.model.noise).to_dict(names),
    }
    return data, deviations, quantile * deviations


def _series(observed: Observation, residuals: Array) -> Data:
    """Return the measured and the fitted values, series by series, and whether the residuals are white."""
    series, off = [], []
    for number, (label, unit) in enumerate(zip(observed.labels, observed.units, strict=True)):
        own = np.flatnonzero(observed.series == number)
        off.append(residuals[own])
        fitted = observed.values[own] + off[-1] * observed.sigma[own]
        columns = {"time": observed.times[observed.rows[own]], "measured": observed.values[own], "fitted": fitted}
        series.append({"label": label, "unit": unit, **{key: one.tolist() for key, one in columns.items()}})
    return {"whiteness": whiteness(off), "series": series}


LIMIT = 1.0  # of the parameters' sizes: a combination that data leave more uncertain than this is not seen
MOST_LAGS, SAMPLES_A_LAG = 10, 5  # Hyndman and Athanasopoulos, Forecasting: Principles and Practice, 3rd ed., 5.4
LEAST = 0.02  # of a combination's largest part: smaller ones are not named
FEWEST = 20  # samples of a series whose correlation in time is looked at


class Information(NamedTuple):
    """Parameters, and combinations of them, that data determine.

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

    def combinations(self, names: list[str]) -> list[str]:
        """Combinations that are not seen, as changes in parts of the parameters' sizes."""
        found = []
        for row, deviation in zip(self.unseen, self.deviations, strict=True):
            named = np.flatnonzero(np.abs(row) > LEAST * np.abs(row).max())
            part = row / np.abs(row).max() * np.sign(row[named[0]])
            parts = [f"{part[k]:+.2g} {names[k]}" for k in named] if len(named) > 1 else [names[named[0]]]
            known = "at all" if np.isinf(deviation) else f"better than ± {deviation:.2g} of its size"
            found.append(f"{', '.join(parts)} ({known})")
        return found

    def to_dict(self, names: list[str]) -> dict[str, Any]:
        """Return plain values, for JSON."""
        condition = float("nan")  # of no parameters
        if len(self.eigenvalues):
            low, high = self.eigenvalues[0], self.eigenvalues[-1]
            condition = float(high / low) if low > 0 else float("inf")
        return {"eigenvalues": self.eigenvalues.tolist(), "condition": condition, "unseen": self.combinations(names)}


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
    """Test whether residuals are free of correlation in time, of series of them in the order of their times.

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
