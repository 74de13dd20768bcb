"""An estimator that takes no time."""

from deepir.live.estimation import SynchronousEstimator
from deepir.recording.estimate import SensorEstimate
from deepir.recording.segments import Segment


class Knowing(SynchronousEstimator):
    """Takes no time to estimate: it knows the pattern."""

    def __init__(self, gain, offset, bad):
        super().__init__()
        self.estimate = SensorEstimate(gain, offset, bad, 8000.0, None, "gain", motion_error=0.0)

    def submit(self, chosen, *, quick, former):
        self._found = Segment(int(chosen.numbers[0]), int(chosen.numbers[-1]), self.estimate)
