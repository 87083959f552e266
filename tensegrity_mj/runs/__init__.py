"""Runs and what is measured on them: comparison, clearance, winches, the flow around rods."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.runs.approaches import Approach as Approach
    from tensegrity_mj.runs.approaches import Clearance as Clearance
    from tensegrity_mj.runs.approaches import Event as Event
    from tensegrity_mj.runs.approaches import Pairs as Pairs
    from tensegrity_mj.runs.clearances import clearance as clearance
    from tensegrity_mj.runs.comparison import Comparison as Comparison
    from tensegrity_mj.runs.comparison import compare as compare
    from tensegrity_mj.runs.convergence import orders_between as orders_between
    from tensegrity_mj.runs.energy import winch_power as winch_power
    from tensegrity_mj.runs.flow_regime import FlowNumbers as FlowNumbers
    from tensegrity_mj.runs.flow_regime import flow_numbers as flow_numbers
    from tensegrity_mj.runs.scoring import Limit as Limit
    from tensegrity_mj.runs.scoring import Score as Score
    from tensegrity_mj.runs.scoring import limit as limit
    from tensegrity_mj.runs.scoring import observed_orders as observed_orders
    from tensegrity_mj.runs.scoring import reference_of as reference_of
    from tensegrity_mj.runs.scoring import score as score
    from tensegrity_mj.runs.statistics import Statistics as Statistics
    from tensegrity_mj.runs.table import Table as Table
    from tensegrity_mj.runs.table import read_table as read_table
    from tensegrity_mj.runs.trajectory import Status as Status
    from tensegrity_mj.runs.trajectory import Trajectory as Trajectory
else:
    __getattr__, __dir__ = face(__name__)
