"""What carries the joints: equations of motion behind a small interface, and the rigid arm on a fixed base.

A mechanism may have more coordinates than the arm has joints (motors behind springs, bending links, a floating
base). Motors and friction act on its *drive* coordinates, which are also what motor encoders see; all others
move freely under the mechanism's own passive forces.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.urdf_chain import bounded
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.parameters import PlantParameters


def rigid_body_model(parameters: PlantParameters) -> pin.Model:
    """Pinocchio model with the parameters' inertias, rotor inertias (armature) and gravity.

    Raises:
        UserError: The description cannot be parsed, or its moving joints are not those of the parameters.
    """
    try:
        model = pin.buildModelFromXML(bounded(parameters.urdf))
    except (ValueError, RuntimeError) as error:
        raise UserError(f"the robot description cannot be parsed ({error}); correct the URDF") from error
    names = tuple(model.names)[1:]
    if names != parameters.joints:
        raise UserError(
            f"the description's moving joints are {', '.join(names)}, "
            f"the model's {', '.join(parameters.joints)}; name the same joints in the same order, base to tip"
        )
    if model.nq != model.nv:
        raise UserError("the simulated arm takes revolute, continuous and prismatic joints; make the others fixed")
    for index, values in enumerate(parameters.rigid_body, start=1):
        model.inertias[index] = pin.Inertia.FromDynamicParameters(values)
    model.armature = parameters.rotor_inertia.copy()
    model.gravity.linear = parameters.gravity
    return model


class RigidMechanism:
    """Rigid links on a fixed base: the coordinates are the joints.

    And the interface of every mechanism: equations of motion A·dv/dt + b = torque in m ≥ n velocity coordinates; SI.

    Attributes:
        size: m.
        drives: Where the n drives are among the coordinates; None: the coordinates are the drives.
        time: s on the recording's clock; set by the plant before each step.
    """

    def __init__(self, parameters: PlantParameters) -> None:
        self._model = rigid_body_model(parameters)
        self._data = self._model.createData()
        self._rotor_inertia = parameters.rotor_inertia
        self.size = self._model.nv
        self.drives: NDArray[np.intp] | None = None
        self.time = 0.0

    def start(self, position: FloatArray) -> FloatArray:
        """Configuration at rest with the drives at `position` (n,)."""
        return position

    def position(self, configuration: FloatArray) -> FloatArray:
        """Drive positions (n,) of a configuration."""
        return configuration

    def moved(self, configuration: FloatArray, velocity: FloatArray, h: float) -> FloatArray:
        """The configuration after a step at constant velocity.

        Args:
            configuration: Generalised positions, as from `start`.
            velocity: (m,) generalised velocity, rad/s or m/s.
            h: Length of the step, s.
        """
        return configuration + h * velocity

    def acceleration(self, configuration: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        """(m,) generalised acceleration under a torque and the mechanism's own forces, rad/s² or m/s².

        Args:
            configuration: Generalised positions, as from `start`.
            velocity: (m,) generalised velocity, rad/s or m/s.
            torque: (m,) generalised force, N·m or N.
        """
        found: FloatArray = pin.aba(self._model, self._data, configuration, velocity, torque)
        return found

    def bias(self, configuration: FloatArray, velocity: FloatArray) -> FloatArray:
        """b, (m,): Coriolis, gravity and passive forces."""
        found: FloatArray = pin.nonLinearEffects(self._model, self._data, configuration, velocity)
        return found

    def inertia(self, configuration: FloatArray) -> FloatArray:
        """A, (m, m), rotors included."""
        return np.array(pin.crba(self._model, self._data, configuration))

    joint_inertia = inertia
    """Inertia (n, n) the drives would feel if everything but the joints were stiff."""

    def load(self, configuration: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(n,) torque that the gears pass on to the links, without rotors and joint friction, N·m.

        Args:
            configuration: Generalised positions, as from `start`.
            velocity: (m,) generalised velocity, rad/s or m/s.
            acceleration: (m,) generalised acceleration, rad/s² or m/s².
        """
        total: FloatArray = pin.rnea(self._model, self._data, configuration, velocity, acceleration)
        return total - self._rotor_inertia * acceleration

    def base(self, configuration: FloatArray, velocity: FloatArray) -> FloatArray | None:
        """Where the base is, then its twist in its own axes: (13,) m, quaternion x y z w, m/s, rad/s; None: fixed."""
        return None
