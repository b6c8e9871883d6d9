"""Another process: restores a serialised state and goes on; prints a hash of what it sees.

worker.py FMU STATE TIME OFFSET STEPS
"""

import hashlib
import sys
import tempfile
from pathlib import Path

from fmu import Fmu, Instance
from test_determinism import operate

path, state, time, offset, steps = sys.argv[1:]
with tempfile.TemporaryDirectory() as folder, Instance(Fmu(path, folder)) as instance:
    instance.restore(Path(state).read_bytes(), float(time))
    seen = [instance.snapshot(), *operate(instance, int(steps), int(offset))]
print(hashlib.sha256(b"".join(seen)).hexdigest())
