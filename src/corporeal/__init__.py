"""corporeal: learn, register, fit and export articulated surface models of hands, bodies and faces."""

import os as _os

# numba's and OpenBLAS's threads share the cores. A pool that spins while it waits stalls the other one's
# small calls by about 8 ms each; it has to be told before either library is imported.
_os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
