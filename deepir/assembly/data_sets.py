"""From a configuration and several bursts to one problem."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from torch import Tensor

from deepir.assembly.problem import build, make_operator
from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import ConfigError
from deepir.fields.base import Field
from deepir.operators import Warp
from deepir.operators.motion_models import Canvas, Geometry
from deepir.problem import Problem

FIRST = ""  # the name of the data set that `data` and `physics` describe


def data_sets(config: Config, burst: Burst) -> Iterator[tuple[str, Config, Burst]]:
    """Name, configuration and frames of each data set, the first one's first."""
    yield FIRST, config, burst
    for name, given in config.datasets.items():
        physics = config.physics if given.physics is None else given.physics
        own = {"physics": physics, "data": given.data, "noise": given.noise}
        yield name, config.model_copy(update=own), burst.datasets[name]


def build_data_sets(
    config: Config, burst: Burst, motions: Mapping[str, Tensor | None]
) -> tuple[dict[str, Problem], dict[str, Geometry]]:
    """The data sets that `config.datasets` describes, their fields at their starts.

    Args:
        config: Already checked by `deepir.config.load`.
        burst: The frames that are used, with those of the other data sets.
        motions: (N, 3, 3) of each data set, as `deepir.assembly.problem.build` takes it.

    Returns:
        The data sets by name, and where the frame 0 of each lies in its scene.

    Raises:
        ConfigError: See `deepir.assembly.problem.build`; or a data set names an unknown that there is not.
    """
    sharing = [FIRST, *(name for name, given in config.datasets.items() if given.scene == "shared")]
    sets = list(data_sets(config, burst))
    warps = []
    for name, own, frames in sets:
        if name in sharing:
            operator, _, _ = make_operator(own, frames.size, len(frames.frames), motions[name])
            warps += [stage for _, stage in operator.named()[:1] if isinstance(stage, Warp)]
    canvas = Canvas.around(warps) if len(warps) > 1 else None
    problems: dict[str, Problem] = {}
    places: dict[str, Geometry] = {}
    known: dict[str, Field] = {}
    for name, own, frames in sets:
        shared = name in sharing
        given = known if shared else {key: field for key, field in known.items() if key != "scene"}
        place = canvas if shared else None
        try:
            problems[name], places[name] = build(own, frames, motions[name], known=given, canvas=place)
        except ConfigError as error:
            if name == FIRST:
                raise
            raise ConfigError(f"datasets.{name}: {error}") from error
        prefix = f"{name}_" if name else ""
        known = {prefix + key: field for key, field in problems[name].fields.items()} | known
    return problems, places
