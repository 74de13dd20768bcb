"""Preconditioner of several data sets: a block for each, and what their scenes have in common.

What the pattern of one sensor may hold makes all scenes before it uncertain. With n frames of precision w in each of B
data sets, and motions that are alike, the curvature along a wave is `w n` in each, less `w n / B` times the square of
the sum of the scenes. So what differs from the scenes' mean has the curvature behind a known pattern, and the mean that
of one data set with a pattern of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from deepir.joint_problem import AnyProblem
from deepir.optim.preconditioner import Preconditioner, make_preconditioner


@dataclass(frozen=True)
class _Block:
    """A data set's parameters, as numbers among all, its preconditioner, and that for a known pattern."""

    at: list[int]
    free: Preconditioner
    known: Preconditioner | None


class BlockPreconditioner:
    """Approximate inverse Hessian of data sets that have no moving unknown in common."""

    def __init__(self, blocks: Sequence[_Block], sizes: Sequence[int]) -> None:
        self.blocks, self.sizes = blocks, list(sizes)
        shapes = {each.free.shape for each in blocks}
        self.one_sensor = all(each.known for each in blocks) and len(shapes) == 1

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Those of all blocks."""
        return {
            f"{i}.{name}": tensor for i, one in enumerate(self._all()) for name, tensor in one.tensors.items()
        }

    @tensors.setter
    def tensors(self, found: dict[str, Tensor]) -> None:
        for i, one in enumerate(self._all()):
            one.tensors = {name: found[f"{i}.{name}"] for name in one.tensors}

    def _all(self) -> list[Preconditioner]:
        return [one for each in self.blocks for one in (each.free, each.known) if one is not None]

    def solve(self, slope: Tensor) -> Tensor:
        """The approximate inverse Hessian times a flat gradient."""
        given, found = slope.split(self.sizes), torch.zeros_like(slope)
        mine = [[given[i] for i in each.at] for each in self.blocks]
        solved = self._of_one_sensor(mine) if self.one_sensor else self._apart(mine)
        into = found.split(self.sizes)
        for each, parts in zip(self.blocks, solved, strict=True):
            for i, part in zip(each.at, parts, strict=True):
                into[i].copy_(part)
        return found

    def _apart(self, slopes: Sequence[Sequence[Tensor]]) -> list[list[Tensor]]:
        return [_solved(each.free, mine) for each, mine in zip(self.blocks, slopes, strict=True)]

    def _of_one_sensor(self, slopes: Sequence[Sequence[Tensor]]) -> list[list[Tensor]]:
        """The scenes' mean and the levels of frames behind a free pattern, all else behind a known one."""
        mean = self._mean(slopes)
        common, rest = [], []
        for each, mine in zip(self.blocks, slopes, strict=True):
            assert each.known is not None
            low = {each.free.scene: mean} | {i: mine[i] for i in each.free.others}
            common.append(
                _solved(each.free, [low.get(i, torch.zeros_like(one)) for i, one in enumerate(mine)])
            )
            rest.append(
                _solved(each.known, [one - low[i] if i in low else one for i, one in enumerate(mine)])
            )
        shared, extra = self._mean(common), self._mean(rest)
        for each, one, other in zip(self.blocks, common, rest, strict=True):
            one[each.free.scene] = shared
            other[each.free.scene] = other[each.free.scene] - extra
        return [[a + b for a, b in zip(*both, strict=True)] for both in zip(common, rest, strict=True)]

    def _mean(self, parts: Sequence[Sequence[Tensor]]) -> Tensor:
        """The mean of the scenes."""
        return torch.stack([one[each.free.scene] for each, one in zip(self.blocks, parts, strict=True)]).mean(
            0
        )


def _solved(preconditioner: Preconditioner, slopes: Sequence[Tensor]) -> list[Tensor]:
    return list(preconditioner.solve(torch.cat(list(slopes))).split(preconditioner.sizes))


def make_block_preconditioner(
    problem: AnyProblem,
    parameters: Sequence[nn.Parameter],
    eliminated: Collection[str] = (),
    *,
    high_frequencies_only: bool = False,
) -> Preconditioner | BlockPreconditioner | None:
    """Preconditioner of an optimiser, or None without a Fourier model of the problem.

    Args:
        problem: Its current values are the point of expansion.
        parameters: Those that the optimiser moves; the scenes' must be among them, and each belongs to one data set.
        eliminated: Unknowns in closed form.
        high_frequencies_only: Leave low frequencies of the scene unchanged.
    """
    blocks, numbers = [], {id(p): i for i, p in enumerate(parameters)}
    for each in problem.data_sets:
        mine = [p for p in each.parameters() if id(p) in numbers]
        mine.sort(key=lambda p: numbers[id(p)])
        own = [name for name, whole in problem.names_in(each).items() if whole in eliminated]
        free = make_preconditioner(each, mine, own, high_frequencies_only=high_frequencies_only)
        if free is None:
            return None
        known = None
        if own and each.same_sensor:
            known = make_preconditioner(each, mine, (), high_frequencies_only=high_frequencies_only)
        blocks.append(_Block([numbers[id(p)] for p in mine], free, known))
    if len(blocks) == 1:
        return blocks[0].free
    several = BlockPreconditioner(blocks, [p.numel() for p in parameters])
    return several if sorted(i for each in blocks for i in each.at) == list(range(len(parameters))) else None
