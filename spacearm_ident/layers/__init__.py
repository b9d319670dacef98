"""From a simulation to the arm, layer by layer: conventions, parameters, physics, the rest.

Each layer is fitted jointly with those before it and judged on recordings that no fit has seen.

    wiring       what a recording's gains, zeros and clock are off by, and its torque and motion without that
    linear       torque of motions, linear in everything that may be wrong, as Gram matrices by joint and block of time
    conventions  layer 0: which gains, zeros and delays the data demand
    parameters   layer 1: which of the simulation's parameters are wrong, in combinations that the data determine
    physics      layer 2: what the simulation does not have
    ceiling      layer 3: what a flexible function of the same inputs could still remove
    joint_fit    wiring, parameters and physics together, and nested fits of less
    compare      all of them, one after the other, into a `comparison`
"""
