"""What NVIDIA's flip-evaluator says about the pictures of the test in core/src/metrics/flip.rs.

    pip install flip-evaluator numpy
    python tests/peers/flip.py              prints the two means that the test expects
    python tests/peers/flip.py A.png B.png  the mean for two pictures, to hold against `rebake compare A.png B.png`
"""

import sys

import flip_evaluator
import numpy as np

# 0.7 m from a screen 0.7 m wide with 3840 pixels across, as in the paper.
VIEWING = {"ppd": 67.02064}


def mean(reference, test):
    return flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False, parameters=dict(VIEWING))[1]


def main():
    if len(sys.argv) == 3:
        print(f"{mean(sys.argv[1], sys.argv[2]):.6f}")
        return
    width, height = 64, 48
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    half = np.full_like(x, 0.5)
    reference = np.stack([x / 63, y / 47, half], axis=2)
    shifted = np.stack([x / 63, 1 - y / 47, half], axis=2)
    dark = ((x // 8 + y // 8) % 2 == 1)[:, :, None]
    checkered = reference * np.where(dark, np.float32(0.8), np.float32(1.0))
    for name, test in [("SHIFTED", shifted), ("CHECKERED", checkered)]:
        print(f"{name}: {mean(reference, test.astype(np.float32)):.6f}")


if __name__ == "__main__":
    main()
