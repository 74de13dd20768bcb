"""A problem: unknowns bound to the slots of an operator, and to data."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from deepir.closed_form.normal_equations import sensor_least_squares
from deepir.closed_form.variable_projection import Elimination, eliminate
from deepir.fields.base import Field, Shape
from deepir.fields.constant import Constant
from deepir.likelihoods import Fidelity, Gaussian
from deepir.metrics import RegisteredAverage
from deepir.operators import Chain, Operator, Sensor
from deepir.operators.base import slots_of
from deepir.priors.penalties.base import Penalty, SpatiallyWeighted
from deepir.registry import lookup

if TYPE_CHECKING:
    from deepir.optim.solve import Solution

Values = dict[str, Tensor]
#: Flux, data and precision of samples, (N, 1, h, w), and the levels of their frames, (N,).
Samples = tuple[Tensor, Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a sample's noise: `read + signal * per_unit`, at least `floor`, in squared units of the data."""

    read: float
    per_unit: float
    floor: float


class Problem(nn.Module):
    """`data = operator(scene, **slots) + noise`, with a field for the scene and for each slot.

    Args:
        operator: The physics; the slots of a chain are called `stage.slot`.
        fields: One for each unknown: `scene`, and the unknowns that `slots` names; slots without one are neutral.
        data: The frames, (N, C, h, w); samples whose precision is zero may hold anything finite.
        precision: 1 / noise variance of each sample, same shape; zero where a sample does not count. None: it is
            estimated.
        slots: Slot -> unknown, `{"warp.motion": "motion"}`; None names an unknown after its slot.
        penalties: Unknown -> its penalties by name.
        fidelity: How prediction and data are compared; Gaussian unless given.
        noise: The noise where it is known; None: it is estimated.
        saturation: 1 or -1 where a sample is at an end of the range, and the data a bound; (N, C, h, w), int8.
        agc: Whether the frames may have gains of their own, by which their data are divided on the way.

    Raises:
        ValueError: A slot has no field, and no neutral value; a field or a penalty is of no unknown; the data's shape.
    """

    fields: Mapping[str, Field]
    penalties: Mapping[str, Mapping[str, Penalty]]
    data: Tensor
    precision: Tensor
    held_out: Tensor
    #: Gains by which the frames were divided, (N, 1, 1, 1), about the median of the samples.
    contrast: Tensor
    #: The level that the data are measured from, (), float64; so is the scene.
    reference: Tensor
    gains_are_equal: Tensor  # whether all frames of an AGC were found to share one gain, (), bool
    #: 1 or -1 where a sample is saturated, and the data a bound, (N, C, h, w), int8; None: nowhere.
    saturation: Tensor | None
    moving: Tensor  # samples that show a moving object, (N, 1, h, w), bool
    #: log2 of the extra penalty weight that a smooth scene allows; 0 until it is estimated.
    smoothness_exponent: Tensor
    #: Sum of squared residuals under a weak prior, in variances of the noise, (); inf until it is known.
    reference_misfit: Tensor
    #: Other data sets that show the same gain and offset, see `deepir.joint_problem`.
    same_sensor: tuple[Problem, ...] = ()

    def __init__(
        self,
        operator: Operator,
        fields: Mapping[str, Field],
        data: Tensor,
        precision: Tensor | None = None,
        *,
        slots: Mapping[str, str] | None = None,
        penalties: Mapping[str, Mapping[str, Penalty]] | None = None,
        fidelity: Fidelity | None = None,
        noise: NoiseModel | None = None,
        saturation: Tensor | None = None,
        agc: bool = False,
    ) -> None:
        super().__init__()
        chain = operator if isinstance(operator, Chain) else Chain.of(operator)
        self.operator, self.fidelity = chain, fidelity or Gaussian()
        self.noise, self.agc = noise, agc
        if not isinstance(data, Tensor) or data.ndim != 4 or not data.is_floating_point():
            raise ValueError("data: a tensor of floats, (N, C, h, w), is needed")
        wanted = chain.slots(tuple(fields["scene"].shape), len(data)) if "scene" in fields else {}
        self.slots = dict(slots) if slots is not None else {slot: slot.rpartition(".")[2] for slot in wanted}
        unknowns = {"scene", *self.slots.values()}
        for name in (*fields, *(penalties or {}), "scene"):
            if name not in unknowns & fields.keys():
                raise ValueError(f"{name!r} has no field, or is no unknown; unknowns are {', '.join(sorted(unknowns))}")
        fields = {**fields, **self._neutral(wanted, fields)}
        self.fields = nn.ModuleDict(fields)  # type: ignore[assignment]
        each = {name: nn.ModuleDict(mine) for name, mine in (penalties or {}).items()}
        self.penalties = nn.ModuleDict(each)  # type: ignore[assignment]
        self.register_buffer("data", data)
        self.register_buffer("precision", torch.ones_like(data) if precision is None else precision)
        self.register_buffer("held_out", torch.zeros_like(data, dtype=torch.bool))
        self.register_buffer("saturation", saturation)
        self.register_buffer("moving", torch.zeros_like(data[:, :1], dtype=torch.bool))
        self.register_buffer("contrast", data.new_ones(len(data), 1, 1, 1))
        self.register_buffer("reference", torch.tensor(0.0, dtype=torch.float64))
        self.register_buffer("gains_are_equal", torch.tensor(False))
        self.register_buffer("smoothness_exponent", torch.tensor(0.0))
        self.register_buffer("reference_misfit", torch.tensor(torch.inf, dtype=torch.float64))

    def _neutral(self, wanted: Mapping[str, Shape], fields: Mapping[str, Field]) -> dict[str, Field]:
        """Constant fields for the slots that have none."""
        found: dict[str, Field] = {}
        for slot, shape in wanted.items():
            stage, _, own = slot.rpartition(".")
            neutral = dict(self.operator.named())[stage].neutral
            if (name := self.slots.get(slot, own)) in fields:
                continue
            if own not in neutral:
                raise ValueError(f"slot {slot!r} has no field; fields are {sorted(fields)}")
            found[self.slots.setdefault(slot, name)] = Constant(shape, neutral[own])
        return found

    def solve(self, problem: str = "generic", *, seed: int = 0, callbacks: Sequence[Any] = ()) -> Solution:
        """Estimate the unknowns that are free, as a registered problem does.

        Args:
            problem: Its name, such as `generic` or `nuc`: the order of the stages, and the weights of penalties.
            seed: Of the samples that are held out.
            callbacks: Called with a `deepir.optim.solve.Progress` after each iteration.

        Returns:
            Values of the unknowns, and how the solve ended; the fields keep the values, too.
        """
        found: Solution = lookup("problem", problem)().solve(self, seed=seed, callbacks=callbacks)
        return found

    @property
    def data_sets(self) -> tuple[Problem, ...]:
        """The problem itself: see `deepir.joint_problem` for several."""
        return (self,)

    @property
    def scenes(self) -> dict[str, tuple[Problem, ...]]:
        """Unknowns that are scenes, and the data sets that show each."""
        return {"scene": (self,)}

    def names_in(self, data_set: Problem) -> dict[str, str]:
        """Names of the unknowns in a data set, and in the whole problem: the same."""
        return {name: name for name in self.fields}

    def slot(self, kind: type[Operator], slot: str) -> str:
        """The name of a slot of the first stage of a kind; "" if there is none."""
        names = (f"{name}.{slot}" for name, stage in self.operator.named() if isinstance(stage, kind))
        return next((name for name in names if name in self.slots), "")

    @property
    def sensor(self) -> Sensor | None:
        """The sensor, where it is the last stage."""
        last = self.operator.named()[-1][1]
        return last if isinstance(last, Sensor) else None

    def sensor_unknowns(self) -> dict[str, str]:
        """The unknowns of `gain`, `offset` and `level` of the sensor; empty without one."""
        stages = [name for name, stage in self.operator.named() if isinstance(stage, Sensor)]
        kinds = ("gain", "offset", "level")
        return {kind: self.slots[f"{name}.{kind}"] for name in stages[:1] for kind in kinds}

    def gain_and_offset(self) -> list[str]:
        """The unknowns of gain and offset of the sensor; [] without one."""
        return list(self.sensor_unknowns().values())[:2]

    def motion_unknown(self) -> str:
        """The unknown of the motion of the stage that moves with the camera; "" without one."""
        name = next((name for name, stage in self.operator.named() if stage.moves), None)
        return "" if name is None else self.slots[f"{name}.motion"]

    def field_of(self, slot: str) -> Field:
        """The field of the unknown that a slot takes."""
        return self.fields[self.slots[slot]]

    def values(self, free: Collection[str] | None = None, without: Collection[str] = ()) -> Values:
        """The value of each unknown but those in `without`; those not in `free` carry no gradient (None: all do)."""
        found = {}
        for name, field in self.fields.items():
            if name in without:
                continue
            with torch.set_grad_enabled(torch.is_grad_enabled() and (free is None or name in free)):
                found[name] = field()
        return found

    def predict(self, values: Values) -> Tensor:
        """The noiseless frames, (N, C, h, w)."""
        return self.operator(values["scene"], **self._slot_values(values))

    def flux(self, values: Values) -> Tensor:
        """Irradiance on the detector: the prediction before the sensor, which must be the last stage."""
        x, slots = values["scene"], self._slot_values(values)
        for name, stage in self.operator.named()[:-1]:
            x = stage(x, **slots_of(slots, name))
        return x.expand(len(self.data), *x.shape[1:])

    def measure_from(self, level: float) -> None:
        """Subtract a reference level, in the units of the input, from the data.

        The sensor's equation is the same, with the offset at the new level. The scene is to be started anew.
        """
        self.data = self.data - (level - float(self.reference))  # the frames themselves stay as they are
        self.reference.fill_(level)

    def divide_frames(self, gain: Tensor, middle: Tensor | float | None = None) -> None:
        """Divide the frames by gains (N,) about a level: the samples' median, which a wrong gain hardly shifts."""
        gain = gain.to(self.data)[:, None, None, None]
        middle = self.middle() if middle is None else middle
        self.data.sub_(middle).div_(gain).add_(middle)
        self.contrast.mul_(gain)

    def middle(self) -> Tensor:
        """The median of the samples that count, about which frames are divided by gains."""
        return self.data[self.precision > 0].median()

    def fitted(self) -> Tensor:
        """The precision, zero at held-out samples."""
        return torch.where(self.held_out, 0, self.precision)

    def losses(self, values: Values, eliminated: Collection[str] = (), *, precision: Tensor | None = None) -> Values:
        """The objective's terms in nats, by name: `data`, `unknown.penalty`, and `unknown` for a field's own.

        Unknowns in `eliminated` are first set to their optimum in closed form, given the others; `values`, which
        may lack them, is updated. `precision` stands in for that of the samples that are fitted.
        """
        precision = self.fitted() if precision is None else precision
        return {"data": self.misfit(values, eliminated, precision)} | self.priors(values, eliminated)

    def priors(self, values: Values, eliminated: Collection[str] = ()) -> Values:
        """Penalty terms by name, for the unknowns in `values`."""
        terms = {}
        for name, field in self.fields.items():
            if name not in values:
                continue
            with torch.set_grad_enabled(torch.is_grad_enabled() and name not in eliminated):
                prior = field.penalty()
            if prior is not None:
                terms[name] = prior
            for kind, penalty in self.penalties[name].items() if name in self.penalties else ():
                terms[f"{name}.{kind}"] = penalty(self.shown(name, values[name], penalty))
        return terms

    def shown(self, name: str, value: Tensor, penalty: Penalty) -> Tensor:
        """What a penalty acts on: the unknown's value, or the scene's samples at pixel centres."""
        return self.operator.to_pixels(value) if penalty.acts_on_pixels and name == "scene" else value

    def represent(self, name: str, field: Field, penalties: Mapping[str, Penalty]) -> None:
        """Replace the field and the penalties of an unknown; spatial weight maps are inherited."""
        before = self.penalties[name].values() if name in self.penalties else ()
        for old in before:
            for new in penalties.values():
                if isinstance(old, SpatiallyWeighted) and isinstance(new, SpatiallyWeighted):
                    new.inherit_weights(old)
        self.fields[name] = field  # type: ignore[index]
        self.penalties[name] = nn.ModuleDict(penalties)  # type: ignore[index]

    def misfit(self, values: Values, eliminated: Collection[str], precision: Tensor) -> Tensor:
        """Negative log-likelihood of the data, in nats; the `data` term of `losses`."""
        if self.sensor is None:
            return self.fidelity(self.predict(values), self.data, precision)
        flux = self.flux(values)
        if not eliminated:
            return self.sensor_misfit(values, flux, precision)
        found = self.eliminate_from([self.samples(values, eliminated, flux, precision)], values, eliminated)
        return self.sensor_misfit(values, flux, precision, found.log_det_gradient())

    def sensor_misfit(
        self, values: Values, flux: Tensor, precision: Tensor, log_det: tuple[Tensor, Tensor, Tensor] | None = None
    ) -> Tensor:
        """The same given the flux on a sensor that is the last stage; see `sensor_least_squares` for `log_det`."""
        name, last = self.operator.named()[-1]
        slots = slots_of(self._slot_values(values), name)
        gain, offset, level = (slots[kind] for kind in ("gain", "offset", "level"))
        if isinstance(self.fidelity, Gaussian) and not (gain.requires_grad or offset.requires_grad):
            return sensor_least_squares(flux, self.data, precision, (gain, offset, level), log_det)
        return self.fidelity(last(flux, **slots), self.data, precision)

    def alive(self) -> Tensor:
        """Pixels (h, w), bool, with a sample that counts, or a bound."""
        some = self.precision > 0
        return (some if self.saturation is None else some | (self.saturation != 0)).any(0).any(0)

    def free(self) -> list[str]:
        """Unknowns with parameters that are not fixed."""
        moving = {name: [p for p in field.parameters() if p.requires_grad] for name, field in self.fields.items()}
        return [name for name, parameters in moving.items() if any(p.numel() for p in parameters)]

    def closed_form(self) -> list[str]:
        """Unknowns with an optimum in closed form: Gaussian gain and offset of a sensor that ends the operator.

        None of frames of several channels: these move by L-BFGS along with the rest.
        """
        if self.sensor is None or not self.fidelity.quadratic or self.data.shape[1] > 1:
            return []
        free = self.free()
        mine = [each for each in self.gain_and_offset() if each in free and each not in self.penalties]
        return [each for each in mine if self.fields[each].parts()]

    def valid(self, values: Values) -> Tensor:
        """Samples that are computed from the scene's array alone, bool (N, C, h, w): by geometry."""
        mask = torch.ones_like(values["scene"])
        return (self.operator.valid(mask, **self._slot_values(values)) > 0.5).expand_as(self.data)

    def backproject(self, values: Values, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Registered average of the data on the scene's grid, and the weight of each of its pixels, in frames."""
        average = RegisteredAverage(self, values, weights)
        return average(self.data - average.at_zero), average.weight

    def residual_after_scene_step(
        self, values: Values, residual: Tensor, average: RegisteredAverage | None = None
    ) -> Tensor:
        """Residual of the data after one averaging step of the scene, (N, C, h, w).

        The scene may still be too low at a peak. That leaves as large a residual as a moving object, but the same in
        each frame, and the step removes it.

        Args:
            values: Of the unknowns.
            residual: Of the data, (N, C, h, w), whose registered average is added to the scene.
            average: Registered average to reuse; computed if None.
        """
        step = (average or RegisteredAverage(self, values))(residual)
        return self.data - self.predict(values | {"scene": values["scene"] + step})

    @torch.no_grad()
    def optimum(self) -> tuple[Values, Tensor]:
        """The values of the unknowns, gain and offset at their optimum given the others; and the flux (N, C, h, w)."""
        values = dict(self.values())
        flux = self.flux(values)
        self.solved(values, self.closed_form(), flux=flux)
        return values, flux

    @torch.no_grad()
    def solved(
        self, values: Values, group: Collection[str], *, flux: Tensor | None = None, precision: Tensor | None = None
    ) -> Elimination:
        """Posterior of gain and offset given the others; `values` is updated to the optimum of those in `group`.

        From the samples that are fitted, and those of all data sets that show the same sensor. `flux` and `precision`
        spare their computation where they are known.
        """
        flux = self.flux(values) if flux is None else flux
        samples = [self.samples(values, group, flux, self.fitted() if precision is None else precision)]
        slots = [slot for slot, name in self.sensor_unknowns().items() if name in group]
        for other in self.same_sensor:
            theirs, names = other.values(), [other.sensor_unknowns()[slot] for slot in slots]
            samples.append(other.samples(theirs, names, other.flux(theirs), other.fitted()))
        return self.eliminate_from(samples, values, group)

    @torch.no_grad()
    def samples(self, values: Values, group: Collection[str], flux: Tensor, precision: Tensor) -> Samples:
        """What the unknowns of `group` are to explain: the data less what is known of gain and offset."""
        gain, offset, level = self.sensor_unknowns().values()
        data = self.data if gain in group else self.data - values[gain] * flux
        if offset not in group and values[offset].any():
            data = data - values[offset]
        if (levels := values[level]).numel() > len(levels):  # of lines
            data, levels = data - levels, torch.zeros_like(levels[..., 0, 0])
        return flux.detach(), data, precision, levels.flatten()

    @torch.no_grad()
    def eliminate_from(self, samples: Sequence[Samples], values: Values, group: Collection[str]) -> Elimination:
        """Set the unknowns of `group` to their optimum given the `samples` of one or several data sets."""
        gain, offset = self.gain_and_offset()
        flux, data, precision, level = (
            each[0] if len(each) == 1 else torch.cat(each) for each in zip(*samples, strict=True)
        )
        parts = [self.fields[each].parts() if each in group else () for each in (gain, offset)]
        neutral = [self.fields[each].neutral if each in group else 0.0 for each in (gain, offset)]
        found = eliminate(flux, data, precision, *parts, level=level, neutral=(neutral[0], neutral[1]))
        both = zip((gain, offset), found.values, strict=True)
        values.update({name: value[None, None] for name, value in both if name in group})
        return found

    def _slot_values(self, values: Values) -> Values:
        return {slot: values[unknown] for slot, unknown in self.slots.items() if unknown in values}
