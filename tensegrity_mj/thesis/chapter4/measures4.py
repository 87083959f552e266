"""What the rows of chapter 4 measure: coordinates and sums of u of the cross (§4.6.1) and of the beam (§4.6.2)."""

from __future__ import annotations

import math

import numpy as np

from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.thesis import measures

SNAPSHOTS = (0.0, 20.0, 40.0, 60.0)  # s, of figure 4.8
CROSSING = (4, 5)  # of the describing lengths: the crossing strings of odd and of even cells


def error_dynamics(run: Trajectory) -> float:
    """Largest deviation of an error of q from (1 + t) e^(-t) e(0), over e(0)."""
    goal = measures.cross_coordinates(run, measures.aims(run)[-1])
    error = measures.cross_coordinates(run) - goal
    promised = ((1.0 + run.time) * np.exp(-run.time))[:, None] * error[0]
    return float(np.max(np.abs(error - promised) / np.abs(error[0])))


def tracking_error(*runs: Trajectory) -> float:
    """Largest distance [m] of a node from its reference."""
    return max(float(run.target_error().max()) for run in runs)


def coordinate(run: Trajectory, sample: int, number: int) -> float:
    """A coordinate of the cross, numbered from 0, at a sample [m, °]."""
    return float(measures.cross_coordinates(run)[sample, number])


def coordinate_within(run: Trajectory, number: int, low: float, high: float) -> bool:
    """Whether a coordinate of the cross stays between two values."""
    values = measures.cross_coordinates(run)[:, number]
    return bool(np.all((values > low) & (values < high)))


def top_rate(run: Trajectory) -> float:
    """Largest |ẏ₁| of the cross [m/s]."""
    return float(np.abs(run.velocities[:, 0, 2]).max())


# ------------------------------------------------------------------------------------------------------- sums of u


def top_sum(run: Trajectory) -> float:
    """Largest sum of all u [N/m]."""
    return float(measures.sums(run).max())


def top_sum_over(run: Trajectory, bound: float) -> float:
    """The largest sum over its bound [N/m]."""
    return top_sum(run) / bound


def smallest_sum(run: Trajectory) -> float:
    """Smallest sum of all u [N/m]."""
    return float(measures.sums(run).min())


def smallest_sum_per_string(run: Trajectory) -> float:
    """The smallest sum over the number of strings [N/m]."""
    return smallest_sum(run) / len(run.scene.structure.strings)


def sum_off(run: Trajectory, bound: float) -> float:
    """Largest distance of the sum from its bound, over the bound."""
    return float(np.abs(measures.sums(run) / bound - 1.0).max())


def time_off(run: Trajectory, bound: float, number: int, end: int) -> float:
    """When [s] the sum leaves its bound (end 0) or is back on it (1), for the time of that number from 0."""
    found = measures.times_off(run, bound)
    return found[number][end] if number < len(found) else math.nan


def part_on_bound(run: Trajectory, bound: float) -> float:
    """Part of the time that the sum is on its bound, to a thousandth."""
    return float(np.mean(measures.sums(run) <= bound * (1.0 + 1e-3)))


def sums_are_ordered(low: Trajectory, middle: Trajectory, high: Trajectory) -> bool:
    """Whether at every time the first run's sum is the least and the second's not above the third's."""
    a, b, c = (measures.sums(run) for run in (low, middle, high))
    return bool(np.all(a <= b + 1e-9) and np.all(b <= c + 1e-9))


def most_over_least_sum(*runs: Trajectory) -> float:
    """Largest over smallest sum of all u; of several runs the least of these."""
    return min(top_sum(run) / smallest_sum(run) for run in runs)


def least_u(run: Trajectory) -> float:
    """Smallest u [N/m]."""
    return float(run.force_densities.min())


# ---------------------------------------------------------------------------------------------- shape of the beam


def shape_equation(run: Trajectory) -> float:
    """Largest residual of (4.15), as corrected, over ℓ², with h = 1 m and ℓ² = 2 m²."""
    phi, inner = measures.sector_angle(run), measures.radii(run)[:, 0]
    found = (1.0 + inner * (1.0 - np.cos(phi))) ** 2 + (inner * np.sin(phi)) ** 2
    return float(np.abs(found / 2.0 - 1.0).max())


def sector_degrees(run: Trajectory, sample: int) -> float:
    """φ [°] at a sample."""
    return math.degrees(float(measures.sector_angle(run)[sample]))


def radius(run: Trajectory, sample: int, outer: bool) -> float:
    """The outer or the inner radius [m] at a sample."""
    return float(measures.radii(run)[sample, int(outer)])


def radius_difference(run: Trajectory) -> float:
    """| r_o - r_i - h | [m] at the end, h = 1 m."""
    return float(abs(measures.radii(run)[-1, 1] - measures.radii(run)[-1, 0] - 1.0))


def largest_length(run: Trajectory) -> float:
    """Largest of the six describing string lengths [m]."""
    return float(measures.describing_lengths(run).max())


def smallest_length(run: Trajectory) -> float:
    """Smallest of the six describing string lengths [m]."""
    return float(measures.describing_lengths(run).min())


def change_of_length(run: Trajectory, column: int) -> float:
    """By how much one of the six describing lengths changes [m]."""
    return float(np.ptp(measures.describing_lengths(run)[:, column]))


def largest_change_of_crossing(run: Trajectory) -> float:
    """The larger change of a crossing string's length [m], of odd and of even cells."""
    return max(change_of_length(run, column) for column in CROSSING)


def smallest_drawn(run: Trajectory, axis: int) -> float:
    """Smallest coordinate [m] of a node at the times of figure 4.8."""
    return float(min(measures.at(run, time, run.nodes[..., axis]).min() for time in SNAPSHOTS))


def largest_drawn(run: Trajectory, axis: int) -> float:
    """Largest coordinate [m] of a node at the times of figure 4.8."""
    return float(max(measures.at(run, time, run.nodes[..., axis]).max() for time in SNAPSHOTS))


def off_straight(run: Trajectory) -> float:
    """Largest distance [m] of a node from the straight beam 0 <= y <= 1 m at the start."""
    return float(np.abs(run.nodes[0, :, 2] - np.round(run.nodes[0, :, 2])).max())


def covered_angle(run: Trajectory) -> float:
    """The angle that the 40 rods cover at the end [°]: 20 sectors, each turned by 2/3 of one."""
    return sector_degrees(run, -1) * (1.0 + 19.0 * 2.0 / 3.0)


# ------------------------------------------------------------------------------------------------- groups and cells


def group_mean(run: Trajectory, group: str) -> float:
    """Mean u [N/m] of a group of the beam's strings."""
    return float(measures.beam_group(run, group).mean())


def group_over_all(run: Trajectory, group: str) -> float:
    """Mean u of a group over that of all strings."""
    return group_mean(run, group) / float(run.force_densities.mean())


def group_altered(run: Trajectory, other: Trajectory, group: str) -> float:
    """Mean u of a group over that of another run."""
    return group_mean(run, group) / group_mean(other, group)


def rims_lead(run: Trajectory) -> bool:
    """Whether the rims' mean u is more than twice that of any other group."""
    rims = group_mean(run, "rims")
    return all(rims > 2.0 * group_mean(run, group) for group in ("verticals", "even", "odd"))


def largest_cell_sum(run: Trajectory) -> float:
    """Largest sum of u of a cell [N/m]."""
    return float(measures.cell_sums(run).max())


def smallest_cell_sum(run: Trajectory) -> float:
    """Smallest sum of u of a cell [N/m]."""
    return float(measures.cell_sums(run).min())


def odd_cells(run: Trajectory, bound: float) -> float:
    """Mean sum of cells 3, 5, ..., 37 over a bound [N/m]."""
    return float(measures.cell_sums(run)[:, 2:37:2].mean()) / bound


def even_cells(run: Trajectory, bound: float) -> float:
    """Smallest sum of cells 2, 4, ..., 38 over a bound [N/m]."""
    return float(measures.cell_sums(run)[:, 1:38:2].min()) / bound


def spread_of_cells(run: Trajectory) -> float:
    """Largest over smallest sum of a cell, at the time where that is most."""
    cells = measures.cell_sums(run)
    return float((cells.max(axis=1) / cells.min(axis=1)).max())


def spreads_of_cells(run: Trajectory, other: Trajectory) -> float:
    """The spread of the cells over that of another run."""
    return spread_of_cells(run) / spread_of_cells(other)
