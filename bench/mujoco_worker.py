"""MuJoCo's side of `peers.py`: `mujoco.sysid` in its own Python, answers one JSON line a request.

Everything it offers for a joint and its link is estimated by its own optimiser: ten inertial parameters (as
pseudo-inertia, always consistent), armature, damping of first to third order, friction loss. Its usual residual is of
the states of a simulation driven by the measured torque: minutes for such an arm (see docs/peers.md). This one is
the torque of its inverse dynamics less the measured one, low-passed, by the hooks it has for a rollout and a residual
of one's own, at a tenth of the samples.
"""

from __future__ import annotations

import sys
import time

import mujoco
import numpy as np
from mujoco import sysid
from scipy.signal import butter, sosfiltfilt
from worker_loop import serve

RATE_HZ = 100.0
EDGE_S = 0.3
ITERATIONS = 30
OF_A_JOINT = {
    "armature": (1.0, 0.0, 20.0),
    "damping": ([5.0, 0.0, 0.0], -50.0, 100.0),
    "frictionloss": (5.0, 0.0, 50.0),
}
"""What is estimated of a joint: first value, lower and upper bound."""


class Worker:
    """What `peers.py` may ask for."""

    def __init__(self, urdf, joints):
        self.urdf = urdf
        self.joints = joints

    def identify(self, fit, motions, out):
        """Time of everything from filtered signals to a model; predicted torque by motion."""
        signals = [np.load(path) for path in fit]
        start = time.process_time()
        spec = self.spec()
        model = spec.compile()
        parameters = self.parameters(spec, model)
        residuals = [self.residual(spec, model, part) for part in signals]

        def residual(x, values, **options):
            parts = [one(x, values, **options) for one in residuals]
            return tuple([item for part in parts for item in part[k]] for k in range(3))

        found, _ = sysid.optimize(parameters, residual, verbose=False, max_iters=ITERATIONS)
        model = sysid.apply_param_modifiers(found, spec)
        seconds = time.process_time() - start
        torques = {}
        for number, motion in enumerate(motions):
            torques[str(number)] = torque(model, *(np.load(motion)[key] for key in ("q", "qd", "qdd")))
        np.savez(out, **torques)
        return {"seconds": seconds, "parameters": found.size}

    def spec(self):
        """The arm with a motor and a torque sensor at every joint; nothing collides."""
        spec = mujoco.MjSpec.from_file(self.urdf)
        spec.option.timestep = 1.0 / RATE_HZ
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        for name in self.joints:
            spec.joint(name).actfrclimited = False
            spec.add_actuator(name=f"{name}_motor", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            sensor = mujoco.mjtSensor.mjSENS_JOINTACTFRC
            spec.add_sensor(name=f"{name}_tau", type=sensor, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)
        return spec

    def parameters(self, spec, model):
        """All unknowns; the inertials within the toolbox's own bounds."""
        found = sysid.ParameterDict()
        for name in self.joints:
            body = model.body(model.jnt_bodyid[model.joint(name).id]).name
            found.add(sysid.body_inertia_param(spec, model, body, sysid.InertiaType.Pseudo, modifier=inertia(body)))
            for what, (first, lower, upper) in OF_A_JOINT.items():
                bounds = np.full(np.size(first), lower), np.full(np.size(first), upper)
                found.add(sysid.Parameter(f"{name}_{what}", first, *bounds, modifier=setter(name, what)))
        return found

    def residual(self, spec, model, part):
        """The toolbox's residual function of one uninterrupted run."""
        thin = round(float(part["rate_hz"]) / RATE_HZ)
        whole = len(part["q"]) // thin * thin
        q, qd, qdd, tau = (
            part[key][:whole].reshape(-1, thin, len(self.joints)).mean(axis=1) for key in ("q", "qd", "qdd", "tau")
        )
        times = np.arange(len(q)) / RATE_HZ
        state = sysid.TimeSeries(times, np.hstack([times[:, None], q, qd]))
        measured = sysid.TimeSeries.from_names(times, tau, model)
        control = sysid.TimeSeries.from_control_names(times, tau, model)
        low_pass = butter(4, float(part["cutoff_hz"]), fs=RATE_HZ, output="sos")
        inner = slice(int(EDGE_S * RATE_HZ), -int(EDGE_S * RATE_HZ))

        def inverse(models, **_):
            predicted = [sysid.TimeSeries(times, torque(one, q, qd, qdd), measured.signal_mapping) for one in models]
            return [
                sysid.SystemTrajectory(one, control, series, state.data[0], state)
                for one, series in zip(models, predicted)
            ]

        def compared(_, predicted, known, *__, **___):
            apart = sosfiltfilt(low_pass, known.data - predicted.data, axis=0)[inner]
            return sysid.normalize_residual(apart, known.data[inner]), predicted, known

        return sysid.build_residual_fn(
            models_sequences=[sysid.ModelSequences("arm", spec, "run", state.data[0], control, measured)],
            custom_rollout=inverse,
            modify_residual=compared,
            n_threads=1,
            resample_true=False,
        )


def inertia(body):
    """The toolbox's modifier of a body's inertials; version 4.0.0 leaves an orientation that MuJoCo refuses."""

    def modifier(spec, parameter):
        sysid.apply_body_inertia(spec, body, parameter)
        spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]

    return modifier


def setter(joint, what):
    """The modifier that writes a parameter into a model."""

    def modifier(spec, parameter):
        setattr(spec.joint(joint), what, parameter.value if what == "damping" else float(parameter.value[0]))

    return modifier


def torque(model, q, qd, qdd):
    """(N, n) torque of the model: its inverse dynamics, and its dry friction as sharp as it means it.

    MuJoCo's own inverse dynamics softens friction loss, which is worth having in a simulation and not in a prediction.
    """
    data, dry = mujoco.MjData(model), model.dof_frictionloss.copy()
    total = dry * np.sign(qd)
    model.dof_frictionloss[:] = 0.0
    for row, state in zip(total, zip(q, qd, qdd)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        row += data.qfrc_inverse
    model.dof_frictionloss[:] = dry
    return total


def main():
    urdf, _, *joints = sys.argv[1:]
    serve(lambda: Worker(urdf, joints))


if __name__ == "__main__":
    main()
