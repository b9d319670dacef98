"""Physics that can be concealed in the simulated arm, for a finder of model errors to find.

Written as physics happens (two inertias and a spring, bristles that slip, a base that floats), never as terms of a
torque model: whoever fits must not recognise his own formulas. `load_concealed` reads a file, `Concealment` puts
effects into a run (`simulate_truth(..., hidden=...)`), `EFFECTS` lists what there is.
"""

from spacearm_ident.simulation.concealed.concealment import Concealment
from spacearm_ident.simulation.concealed.effect import Effect
from spacearm_ident.simulation.concealed.file import EFFECTS, concealed_from_dict, load_concealed, make_effect

__all__ = ["EFFECTS", "Concealment", "Effect", "concealed_from_dict", "load_concealed", "make_effect"]
