"""How far beyond a joint's limit an effort may be and still be a torque of that joint."""

BEYOND_TORQUE = 3.0
"""Multiple of a joint's effort limit beyond which a value is no torque of it: drives allow peaks of two to three times
the rated torque, and a limit is at least the rated one."""
