"""Workers that leave Ctrl-C to the process that started them."""

import signal

from distributed import Worker, WorkerPlugin


class IgnoreInterrupts(WorkerPlugin):
    """Ignore Ctrl-C, which a terminal sends to the workers too; each would end with a traceback."""

    name = "deepir-uninterrupted"

    def setup(self, worker: Worker) -> None:
        """Called in the main thread of each worker as it starts, replacements included."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
