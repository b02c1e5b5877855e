"""The estimators as the daemon runs them: the fold, its fits in another process, their kernels."""

import gc

from tilth.logger.compiling import Preparing
from tilth.logger.fitting import Worker
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.flow import EventKind
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, Report, notice


class LiveEstimation:
    def __init__(self, machine: Machine, report: Report) -> None:
        self._report = report
        self.worker = Worker(machine, report)
        self.fold = GuardedFold(machine, fitter=self.worker)
        self.preparing = Preparing(machine, report)
        self.fold.ready = self.preparing.ready  # until then its poses need nothing that is compiled

    def can_begin(self) -> bool:
        """Whether the kernels have become ready since the last frame."""
        return self.preparing.ready and not self.fold.ready

    def begin(self) -> None:
        """With the next frame, which the caller logs before."""
        if seconds := self.preparing.seconds:
            self._report(EventKind.COMPILED, notice(NoticeCode.KERNELS_COMPILED, compiling_s=seconds))
        self.fold.ready = True
        gc.freeze()  # what was compiled or loaded stays

    def start_worker(self) -> None:
        """As soon as there are poses a fit may be asked for; loading and compiling takes longer than one."""
        if self.fold.ready and self.fold.poses:
            self.worker.start()
