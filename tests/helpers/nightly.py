"""What the environment says of the long attack.

COSIM_NIGHTLY scales it: 0.01 is a hundredth. COSIM_NIGHTLY_SEED draws other cases.
"""

import os

SCALE = float(os.environ.get("COSIM_NIGHTLY", "1"))
SEED = int(os.environ.get("COSIM_NIGHTLY_SEED", "0"))
