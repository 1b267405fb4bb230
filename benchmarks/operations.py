"""Scalar operations of every right-hand side, with numbers for the parameters.

Compares with the recorded baseline; `--record` replaces it, once a rise has been explained.
"""

import json
import sys
from pathlib import Path

import casadi_models

BASELINE = Path(__file__).with_name("operations.json")


def counts() -> dict[str, int]:
    return {name: casadi_models.load(name).operations() for name in casadi_models.CATALOG}


def main() -> int:
    now = counts()
    if "--record" in sys.argv:
        BASELINE.write_text(json.dumps(now, indent=1) + "\n")
    recorded = json.loads(BASELINE.read_text())
    for name, count in now.items():
        print(f"{name:32} {count:6} (recorded {recorded[name]})")
    return int(any(count > recorded[name] for name, count in now.items()))


if __name__ == "__main__":
    sys.exit(main())
