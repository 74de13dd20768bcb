"""Several data sets, one problem: bursts, single frames, flats or other cameras that share unknowns."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence

import torch
from torch import Tensor, nn

from deepir.fields.base import Field
from deepir.priors.penalties.base import Penalty
from deepir.problem import Problem, Samples, Values


class JointProblem(nn.Module):
    """The data sets' objectives, summed; a field that several of them have is one unknown.

    Each data set is a problem with an operator, data and noise of its own. Unknowns of the first one keep their names,
    as shared ones do; others have their data set's name before theirs, `coarse_gain`. Penalties of a shared unknown are
    those of the first data set that has it. Gain and offset that are the same two fields in several data sets are
    eliminated from the samples of all of them.

    Args:
        first: The data set whose frame 0 the results refer to.
        others: The others by name.
    """

    def __init__(self, first: Problem, others: Mapping[str, Problem]) -> None:
        super().__init__()
        self.first, self.others = first, nn.ModuleDict(others)
        known: dict[Field, str] = {}
        self._names = [
            {own: known.setdefault(field, prefix + own) for own, field in each.fields.items()}
            for prefix, each in (("", first), *((f"{name}_", one) for name, one in others.items()))
        ]
        for each in self.data_sets:
            mine = _sensor_fields(each)
            same = (other for other in self.data_sets if mine and _sensor_fields(other) == mine)
            each.same_sensor = tuple(other for other in same if other is not each)

    @property
    def data_sets(self) -> tuple[Problem, ...]:
        """The first one, and the others."""
        return (self.first, *self.others.values())  # type: ignore[arg-type]

    @property
    def scenes(self) -> dict[str, tuple[Problem, ...]]:
        """Unknowns that are scenes, and the data sets that show each."""
        found: dict[str, tuple[Problem, ...]] = {}
        for each in self.data_sets:
            name = self.names_in(each)["scene"]
            found[name] = (*found.get(name, ()), each)
        return found

    @property
    def fields(self) -> dict[str, Field]:
        """The field of each unknown."""
        return {name: each.fields[own] for each in self.data_sets for own, name in self.names_in(each).items()}

    @property
    def penalties(self) -> dict[str, Mapping[str, Penalty]]:
        """The penalties of each unknown that has any."""
        return {name: each.penalties[own] for each, own, name in self._firsts() if own in each.penalties}

    def names_in(self, data_set: Problem) -> dict[str, str]:
        """Names of a data set's unknowns, and their names in the whole problem."""
        return self._names[self.data_sets.index(data_set)]

    def represent(self, name: str, field: Field, penalties: Mapping[str, Penalty]) -> None:
        """Replace the field and the penalties of an unknown, in all data sets that have it."""
        for each in self.data_sets:
            for own in (own for own, known in self.names_in(each).items() if known == name):
                each.represent(own, field, penalties)

    def free(self) -> list[str]:
        """Unknowns with parameters that are not fixed."""
        return [name for each, own, name in self._firsts() if own in each.free()]

    def closed_form(self) -> list[str]:
        """Unknowns with an optimum in closed form: gain or offset in all data sets that have it, beside one partner."""
        partners: dict[str, set[tuple[Field, ...]]] = {}
        for each in self.data_sets:
            closed = each.closed_form()
            for own, name in self.names_in(each).items():
                partners.setdefault(name, set()).add(_sensor_fields(each) if own in closed else ())
        return [name for name, pairs in partners.items() if len(pairs) == 1 and () not in pairs]

    def values(self, free: Collection[str] | None = None, without: Collection[str] = ()) -> Values:
        """The value of each unknown, see `Problem.values`."""
        found: Values = {}
        for each in self.data_sets:
            names = self.names_in(each)
            new = {own: name for own, name in names.items() if name not in found and name not in without}
            moving = None if free is None else [own for own, name in new.items() if name in free]
            mine = each.values(moving, without=[own for own in names if own not in new])
            found |= {new[own]: value for own, value in mine.items()}
        return found

    @property
    def precision(self) -> Sequence[Tensor]:
        """Inverse noise variances of each data set."""
        return [each.precision for each in self.data_sets]

    def fitted(self) -> Sequence[Tensor]:
        """The precisions, zero at held-out samples."""
        return [each.fitted() for each in self.data_sets]

    def losses(self, values: Values, eliminated: Collection[str] = ()) -> Values:
        """The objective's terms in nats, by name, see `Problem.losses`."""
        return {"data": self.misfit(values, eliminated, self.fitted())} | self.priors(values, eliminated)

    def priors(self, values: Values, eliminated: Collection[str] = ()) -> Values:
        """Penalty terms by name, for the unknowns in `values`."""
        terms: Values = {}
        for each, own, name in self._firsts():
            if name in values:
                mine = each.priors({own: values[name]}, [own] if name in eliminated else ())
                terms |= {name + term.removeprefix(own): nats for term, nats in mine.items()}
        return terms

    def misfit(self, values: Values, eliminated: Collection[str], precision: Sequence[Tensor]) -> Tensor:
        """Negative log-likelihood of all data, in nats; `values` takes in what is eliminated."""
        weights = dict(zip(self.data_sets, precision, strict=True))
        left, total = list(self.data_sets), []
        while left:
            first = left.pop(0)
            group = self._own(first, eliminated)
            if not group:
                total.append(first.misfit(self._own_values(first, values), (), weights[first]))
                continue
            together = [first, *first.same_sensor]
            left = [each for each in left if each not in together]
            total += self._eliminated(together, values, eliminated, weights)
        return torch.stack([nats.double() for nats in total]).sum()

    def _eliminated(
        self,
        together: Sequence[Problem],
        values: Values,
        eliminated: Collection[str],
        weights: Mapping[Problem, Tensor],
    ) -> list[Tensor]:
        """Misfits of data sets that share gain and offset, after the elimination of these from all their samples."""
        samples: list[Samples] = []
        fluxes = []
        for each in together:
            mine = self._own_values(each, values)
            fluxes.append(each.flux(mine))
            samples.append(each.samples(mine, self._own(each, eliminated), fluxes[-1], weights[each]))
        first = together[0]
        found = first.eliminate_from(samples, solved := self._own_values(first, values), self._own(first, eliminated))
        values.update({self.names_in(first)[own]: value for own, value in solved.items()})
        nats, variances, system = found.log_det_gradient()
        counted = itertools.chain([nats], itertools.repeat(torch.zeros_like(nats)))  # once, for all of them
        return [
            each.sensor_misfit(self._own_values(each, values), flux, weights[each], (once, variances, system))
            for each, flux, once in zip(together, fluxes, counted, strict=False)
        ]

    def _own(self, data_set: Problem, names: Collection[str]) -> list[str]:
        """Of these unknowns those of a data set, as it calls them."""
        return [own for own, name in self.names_in(data_set).items() if name in names]

    def _own_values(self, data_set: Problem, values: Values) -> Values:
        return {own: values[name] for own, name in self.names_in(data_set).items() if name in values}

    def _firsts(self) -> list[tuple[Problem, str, str]]:
        """Each unknown once: the first data set that has it, its name there, and in the whole problem."""
        found: dict[str, tuple[Problem, str, str]] = {}
        for each in self.data_sets:
            for own, name in self.names_in(each).items():
                found.setdefault(name, (each, own, name))
        return list(found.values())


AnyProblem = Problem | JointProblem  # a problem of one data set, or of several


def _sensor_fields(problem: Problem) -> tuple[Field, ...]:
    """Gain and offset of a sensor that ends the operator; () without one."""
    return () if problem.sensor is None else tuple(problem.fields[name] for name in problem.gain_and_offset())
