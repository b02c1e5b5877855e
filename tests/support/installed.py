"""What a process of an installed Tilth does first, and what it says of its kernels."""

STARTED = """
import json, sys, time
from pathlib import Path
from numba.core import event

class Compilations(event.Listener):
    compiled = 0
    def on_start(self, event):
        pass
    def on_end(self, event):
        Compilations.compiled += 1

event.register("numba:compile", Compilations())
from tilth.logger import compiling, fit_worker
from tilth.logger.machine_file import read_machine
machine, _ = read_machine(Path(sys.argv[1]))
began = time.process_time()
ready = compiling.load(machine)
for rehearse in fit_worker.rehearsals(machine) if ready else ():
    rehearse()
import tilth.estimator.kernel_store as store
print(json.dumps([ready, Compilations.compiled, str(store.PACKAGED), store.target()]))
"""
"""Of the machine file that it is told: whether it was ready without compiling, how many functions it compiled
in all, fits included, the folder of its kernels, and what they are for."""
