"""Seconds from fmi2Instantiate to the end of initialisation mode for the FMUs of scenes.

`target/venv/bin/python tests/bench/instantiate.py SCENE.json ..`, after `./check` has made the environment;
the hybrid liver and the whole liver pre-computed where no scene is named. Prints CSV: scene, size of the FMU,
median of 15, best. TISSUE_FMU names the command, else target/release/tissue-fmu.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/harness"))

from fmu import Fmu, Instance  # noqa: E402


def scenes():
    if sys.argv[1:]:
        return [(Path(p).stem, json.loads(Path(p).read_text())) for p in sys.argv[1:]]
    hybrid = json.loads((ROOT / "examples/hybrid_liver.json").read_text())
    return [("hybrid_liver", hybrid), ("quasi_static_liver", hybrid | {"model": {"kind": "quasiStatic"}})]


def main():
    command = os.environ.get("TISSUE_FMU", str(ROOT / "target/release/tissue-fmu"))
    print("scene,megabytes,median_s,best_s")
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in scenes():
            file = Path(folder) / f"{name}.json"
            file.write_text(json.dumps(scene))
            target = file.with_suffix(".fmu")
            subprocess.run([command, "build", file, "-o", target], check=True, capture_output=True)
            fmu = Fmu(target, folder=file.with_suffix(""))
            times = []
            for _ in range(15):
                begin = time.perf_counter()
                instance = Instance(fmu, log=False)
                times.append(time.perf_counter() - begin)
                instance.slave.freeInstance()
            times.sort()
            print(f"{name},{target.stat().st_size / 1e6:.1f},{times[7]:.4f},{times[0]:.4f}")


if __name__ == "__main__":
    main()
