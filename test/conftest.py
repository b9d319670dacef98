"""Property-based inputs are the same in every run, so that a verdict is the code's and not the draw's.

`HYPOTHESIS_PROFILE=search pytest` draws new ones; what it finds becomes a case of its own.
"""

import os

from hypothesis import settings

settings.register_profile("same", derandomize=True)
settings.register_profile("search", max_examples=300)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
