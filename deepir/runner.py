"""Run a configuration on data in memory."""

from __future__ import annotations

import dataclasses
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

import deepir
from deepir import burst as bursts
from deepir.assembly import FIRST, build, build_data_sets, data_sets
from deepir.config import Config
from deepir.config.schema import DataSet
from deepir.errors import ConfigError, DataError, DeepIRError
from deepir.joint_problem import JointProblem
from deepir.kernels import memory, threads
from deepir.kernels.memory import peak_memory
from deepir.messages import labelled
from deepir.metrics import roughness
from deepir.optim.objective import Checkpoint
from deepir.optim.solve import Progress
from deepir.pipeline.reconstruct import chosen
from deepir.pipeline.register import motion_model
from deepir.pipeline.schedule import PROBLEMS, demand_order, make_recipe, plan, solve_bands
from deepir.problems.recipe import Recipe
from deepir.registry import lookup
from deepir.result import Result, compare_to_truth

Callbacks = Sequence[Callable[[Progress], None]]


def prepare(
    config: Config, frames: np.ndarray[Any, Any] | None = None, truth: bursts.Truth | None = None
) -> bursts.Burst:
    """Read the data and check all that can be checked without solving.

    Args:
        config: The configuration.
        frames: (N, h, w), or (N, C, h, w) of several bands, in place of `data.path`.
        truth: The known scene, or arrays by name, in place of `data.truth`.

    Raises:
        DeepIRError: The configuration, the files or the frames are wrong.
    """
    definition = lookup("problem", config.problem, "problem")
    chosen(config)
    _check_device(config.device)
    if definition.ordered:
        demand_order(config.data.frames, config.problem)
    with threads.for_samples(0), seeded(config.seed):  # nothing here is worth a second thread
        data = bursts.load(
            config.data,
            frames=frames,
            truth=truth,
            needs=definition.frames,
            seed=config.seed,
            ordered=definition.ordered,
            are_pictures=_are_pictures(config, definition),
        )
        others = {name: _further(name, each, config, definition) for name, each in config.datasets.items()}
        data = dataclasses.replace(data, datasets=others)
        check_components(config, data)
    return data


def _are_pictures(config: Config, definition: type[Recipe]) -> bool:
    """Whether frames are registered or else taken for those of a camera."""
    return not definition.any_data or motion_model(config) is not None


def _further(name: str, given: DataSet, config: Config, definition: type[Recipe]) -> bursts.Burst:
    """The frames of a further data set; errors name it."""
    data, physics = given.data, config.physics if given.physics is None else given.physics
    pictures = _are_pictures(config.model_copy(update={"physics": physics}), definition)
    if data.path is None and data.simulate is None:
        raise DataError(f"datasets.{name}.data.path is missing: give the file of this data set")
    try:
        return bursts.load(data, seed=config.seed, are_pictures=pictures)
    except DeepIRError as error:
        raise type(error)(f"datasets.{name}: {error}") from error


def check_components(config: Config, data: bursts.Burst) -> None:
    """Build the problem for a camera at rest, so that errors of components show before a run.

    Raises:
        ConfigError: A component is wrong, or the problem lacks a stage that it needs.
    """
    recipe = make_recipe(config)
    if config.datasets:
        data = dataclasses.replace(data, datasets=dict.fromkeys(config.datasets, data) | {**data.datasets})
        _check_several(config, data, recipe)
        still = {name: _at_rest(each) for name, _, each in data_sets(config, data)}
        problems, _ = build_data_sets(config, data, still)
        plan(JointProblem(problems.pop(FIRST), problems), recipe, config)
        return
    if recipe.checked_frames is not None:
        few = slice(recipe.checked_frames)
        data = dataclasses.replace(data, frames=data.frames[few], valid=data.valid[few], clipped=None)
    problem, _ = build(config, data, _at_rest(data))
    if data.bands and config.problem not in PROBLEMS:
        raise DataError(
            f"{data.source}: frames of {1 + len(data.bands)} bands; problem '{config.problem}' takes one band, "
            f"frames[:, 0]; {' and '.join(PROBLEMS)} take several"
        )
    for name in recipe.operators:
        if not any(isinstance(stage, lookup("operator", name)) for _, stage in problem.operator.named()):
            raise ConfigError(f"physics: problem '{config.problem}' needs a stage '{name}'; or take problem=generic")
    plan(problem, recipe, config)


def _check_several(config: Config, data: bursts.Burst, recipe: Recipe) -> None:
    """Raise `ConfigError` where problem, method or names do not go with several data sets."""
    if wrong := next((name for name in config.datasets if not name.isidentifier()), None):
        raise ConfigError(f"datasets.{wrong}: a data set's name is a word of letters, digits and _")
    if not recipe.several:
        raise ConfigError(f"datasets: problem '{config.problem}' takes one data set; take problem=generic")
    if (method := chosen(config)[0]) != "joint":
        raise ConfigError(f"datasets: method '{method}' takes one data set; take method=joint")
    if data.bands or any(each.bands for each in data.datasets.values()):
        raise DataError("datasets: frames of several bands; give each band as a data set, frames[:, 0] and so on")


def _at_rest(data: bursts.Burst) -> torch.Tensor:
    return torch.eye(3, dtype=torch.float64).repeat(len(data.frames), 1, 1)


def execute(
    config: Config, data: bursts.Burst, *, callbacks: Callbacks = (), checkpoint: Checkpoint | None = None
) -> Result:
    """Run the method on data in memory.

    Args:
        config: The configuration.
        data: The burst.
        callbacks: Called with a `Progress` after each iteration.
        checkpoint: Where the solver saves its state.

    Returns:
        The result; its metrics include time, memory and scores.
    """
    start = time.perf_counter()
    if data.bands:
        whole = solve_bands(data, lambda band: execute(config, band, callbacks=callbacks))
        whole.metrics |= {
            "seconds": round(time.perf_counter() - start, 3),
            "messages": labelled(whole.messages),
            "input_sha256": data.sha256,
        }
        return whole
    name, method = chosen(config)
    # Pixels of the scene for each of the detector.
    finer = float(np.prod(np.broadcast_to((config.physics.get("downsample") or {}).get("factor", 1), 2)))
    with threads.for_samples(int(data.frames.size * finer), config.threads), memory.kept(), seeded(config.seed):
        result: Result = method(data, config, callbacks=callbacks, checkpoint=checkpoint)
    result.messages = [*data.messages, *result.messages]
    result.example, result.config = np.where(data.valid[0], data.frames[0], np.nan), config
    seconds = time.perf_counter() - start
    unknown: dict[str, Any] = {"noise_sigma": None, "held_out_rmse": None, "strengths": {}}
    measured = {"seconds": round(seconds, 3), "peak_memory_mb": peak_memory()}
    quality = {"roughness": roughness(result.scene)} | compare_to_truth(result, data)
    result.metrics = measured | unknown | result.metrics | quality
    if data.radiometry is not None:
        result.radiometry = data.radiometry
        result.extra["scene_kelvin"] = data.radiometry.kelvin(result.scene)
    result.metrics |= {
        "method": name,
        "prior": config.prior,
        "frames": len(result.frames_used),
        "frames_used": int(result.frames_used.sum()),
        "messages": labelled(result.messages),
        "radiometry": None if data.radiometry is None else asdict(data.radiometry),
        "input_sha256": data.sha256,
        "versions": versions(),
        "machine": machine(),
    }
    return result


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Torch's random numbers from a seed; the caller's go on afterwards as if nothing had been drawn."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield


def machine() -> str:
    """The processor and its number of cores, on which timings depend."""
    names = []
    with suppress(OSError, UnicodeDecodeError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = names[0] if names else platform.processor() or platform.machine()  # which may start a program
    return f"{name}, {os.cpu_count()} cores"


def versions() -> dict[str, str]:
    """Versions of deepir, torch and Python, on which results depend."""
    return {"deepir": deepir.__version__, "torch": torch.__version__, "python": platform.python_version()}


def _check_device(name: str) -> None:
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        there = ["cpu"] + ["cuda"] * torch.cuda.is_available() + ["mps"] * torch.backends.mps.is_available()
        reason = str(error).splitlines()[0].split("device type at start")[0][:80]
        raise ConfigError(
            f"device: '{name}' cannot be used here ({reason.strip()}); there is {', '.join(there)}"
        ) from None
