"""How many threads BLAS takes: one, unless the user has decided.

The matrices of an identification have at most a few hundred columns. Sharing such a product among threads costs more
than it saves, and on a machine with other load the threads wait for each other: `spacearm identify` then takes several
times as long. BLAS reads the number once, when numpy is imported, so whoever starts a process
decides: the command line before its first import, the identifier before it starts its worker.
"""

from __future__ import annotations

import os

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""What the BLAS libraries read their number of threads from."""


def one_thread() -> None:
    """One BLAS thread for this process, where numpy is not imported yet, and for those it starts from now on.

    Nothing changes where the user has set any of `VARIABLES`.
    """
    if not any(name in os.environ for name in VARIABLES):
        os.environ.update(dict.fromkeys(VARIABLES, "1"))
