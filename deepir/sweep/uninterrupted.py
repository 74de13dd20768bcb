"""Workers that leave Ctrl-C to the process that started them."""

import signal

from distributed import Worker, WorkerPlugin


class IgnoreInterrupts(WorkerPlugin):
    """Ctrl-C in a terminal reaches the workers too; without this each would end with a traceback of its own."""

    name = "deepir-uninterrupted"

    def setup(self, worker: Worker) -> None:
        """Called in the main thread of each worker as it starts, of one that replaces a lost one too."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
