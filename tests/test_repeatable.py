"""The same frames give the same result to the bit, whatever holds them; in another order, within the noise."""

import functools
import re

import numpy as np
from documentation import ROOT

import deepir
from deepir.burst import load as load_burst
from deepir.config import Data
from deepir.simulate import Settings, simulate


@functools.cache
def burst_frames():
    return simulate(None, Settings(n_frames=4, shape=(48, 64), counts=True), seed=1).frames


@functools.cache
def once(*settings):
    return deepir.run("nuc", *settings, frames=burst_frames(), threads=1)


def same(result, wanted):
    found = result.arrays()
    return all(np.array_equal(value, found[name], equal_nan=True) for name, value in wanted.arrays().items())


def test_any_type_or_layout_in_memory_that_holds_the_same_numbers():
    frames = burst_frames()
    every_second_column = np.repeat(frames.astype(">u2"), 2, 2)[:, :, ::2]
    wanted = load_burst(Data(), frames=frames)
    for held in (*map(frames.astype, ("i4", "f4", "f8", ">u2")), np.asfortranarray(frames), every_second_column):
        burst = load_burst(Data(), frames=held)
        assert (burst.frames.dtype, burst.frames.strides) == (wanted.frames.dtype, wanted.frames.strides)
        for name in ("frames", "valid", "bad_pixels", "clipped"):
            assert np.array_equal(getattr(burst, name), getattr(wanted, name))
    short = "prior=tv", "solver.max_iterations=3"
    assert same(deepir.run("nuc", *short, frames=every_second_column, threads=1), once(*short))


def test_one_thread_or_two():
    assert same(deepir.run("nuc", frames=burst_frames(), threads=2), once())


def test_frames_in_another_order_give_the_same_scene_within_its_noise():
    other = deepir.run("nuc", frames=burst_frames()[[0, 2, 3, 1]], threads=1)
    apart = (other.scene - once().scene) / once().uncertainty["scene"]
    assert np.sqrt(np.mean(apart**2)) < 0.5


def test_least_squares_name_their_driver():
    # torch's default on the CPU pivots by memory that nobody has written (pytorch issue 71222).
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "deepir").rglob("*.py")]
    calls = [call for each in sources for call in re.findall(r"torch\.linalg\.lstsq\(.*", each)]
    assert calls
    assert all("driver=" in call for call in calls)
