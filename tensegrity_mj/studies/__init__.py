"""Studies: many runs of one task, saved as they finish and resumable. `many` is the core, `sweep` runs simulations."""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.faces import face

if TYPE_CHECKING:
    from tensegrity_mj.engines.mujoco.needs import Requirements as Requirements
    from tensegrity_mj.engines.mujoco.needs import requirements as requirements
    from tensegrity_mj.simulation.ensemble import Ensemble as Ensemble
    from tensegrity_mj.simulation.ensemble import law_in as law_in
    from tensegrity_mj.simulation.ensemble import simulate_many as simulate_many
    from tensegrity_mj.studies.identification.fitting import FitOptions as FitOptions
    from tensegrity_mj.studies.identification.measurements import measured as measured
    from tensegrity_mj.studies.identification.result import Identification as Identification
    from tensegrity_mj.studies.identification.result import identify as identify
    from tensegrity_mj.studies.identification.unknowns import Parameter as Parameter
    from tensegrity_mj.studies.many import Study as Study
    from tensegrity_mj.studies.many import run_many as run_many
    from tensegrity_mj.studies.page import write_sweep_page as write_sweep_page
    from tensegrity_mj.studies.parameter_values import Choice as Choice
    from tensegrity_mj.studies.parameter_values import Draw as Draw
    from tensegrity_mj.studies.parameter_values import LogUniform as LogUniform
    from tensegrity_mj.studies.parameter_values import Normal as Normal
    from tensegrity_mj.studies.parameter_values import Scaled as Scaled
    from tensegrity_mj.studies.parameter_values import Together as Together
    from tensegrity_mj.studies.parameter_values import Uniform as Uniform
    from tensegrity_mj.studies.parameter_values import Vary as Vary
    from tensegrity_mj.studies.sweep import Sweep as Sweep
    from tensegrity_mj.studies.validation.sections import Extent as Extent
    from tensegrity_mj.studies.validation.study import Validation as Validation
    from tensegrity_mj.studies.validation.study import validate as validate
    from tensegrity_mj.studies.workers import Backend as Backend
    from tensegrity_mj.studies.workers import WithFiles as WithFiles
    from tensegrity_mj.studies.workers import Workers as Workers
else:
    __getattr__, __dir__ = face(__name__)
