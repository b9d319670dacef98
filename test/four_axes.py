"""An arm of four drives on two simulated buses."""

from simulated_bus import SCALE

from spacearm_ident.canbus.arm_bus import ArmBus, Axis

# Slow enough for a busy machine; the figures at 1 kHz are those of bench/bench_bus.py.
PERIOD = 0.004
ARM = ArmBus(
    tuple(Axis(1 + k, SCALE, bus=k // 2, temperature_object=0x2000) for k in range(4)),
    period=PERIOD,
    answer_time=0.9 * PERIOD,
    heartbeat=0.02,
    heartbeat_timeout=0.15,
)
