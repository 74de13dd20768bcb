"""Bad input: one clear line that says what is wrong and where, exit status 2, nothing written."""

import io

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

RNG = np.random.default_rng(0)


def damaged(name):
    """A file's first part."""

    def write(frames, folder):
        whole = io.BytesIO()
        if name.endswith(".tif"):
            tifffile.imwrite(whole, frames, photometric="minisblack")
        elif name.endswith(".png"):
            Image.fromarray(frames[0]).save(whole, format="PNG")
        else:
            np.savez(whole, frames=frames)
        (folder / name).write_bytes(whole.getvalue()[: len(whole.getvalue()) // 3])
        return name

    return write


def stored(change):
    """`bad.npz` with changed frames."""

    def write(frames, folder):
        np.savez(folder / "bad.npz", frames=change(frames))
        return "bad.npz"

    return write


def all_but_one_are(value):
    return stored(lambda f: np.concatenate([f[:1], np.full_like(f[1:], value, float)]))


def pictures_of_two_sizes(frames, folder):
    (folder / "pictures").mkdir()
    Image.fromarray(frames[0]).save(folder / "pictures/a.png")
    Image.fromarray(frames[1][:30]).save(folder / "pictures/b.png")
    return "pictures"


def two_arrays(frames, folder):
    np.savez(folder / "bad.npz", a=frames, b=frames)
    return "bad.npz"


def text(frames, folder):
    (folder / "bad.npz").write_text("hello")
    return "bad.npz"


DATA = {
    "an unreadable file": (lambda f, d: "/dev/null", ["not an ordinary file"]),
    "a missing file": (lambda f, d: "brust.npz", ["no such file", "did you mean 'burst.npz'"]),
    "an empty folder": (lambda f, d: (d / "none").mkdir() or "none", ["no pictures"]),
    "a truncated npz": (damaged("bad.npz"), ["bad.npz", "damaged or truncated"]),
    "a truncated tiff": (damaged("bad.tif"), ["bad.tif", "truncated"]),
    "a truncated png": (damaged("bad.png"), ["bad.png", "damaged or truncated"]),
    "no picture at all": (text, ["does not begin as a .npz file does", "damaged"]),
    "pickled arrays": (stored(lambda f: np.array([{}, 1], object)), ["pickled", "never loaded"]),
    "two arrays": (two_arrays, ["which array", "data.key", "a (3, 40, 48)"]),
    "colour": (stored(lambda f: np.stack([f] * 3, -1)), ["shape (3, 40, 48, 3)", "(frames, height, width)"]),
    "complex numbers": (stored(lambda f: f * 1j), ["complex"]),
    "one frame": (stored(lambda f: f[:1]), ["1 frame(s)", "at least 2"]),
    "tiny frames": (stored(lambda f: f[:, :8, :8]), ["8 x 8 px is too small"]),
    "pictures of two sizes": (pictures_of_two_sizes, ["differ in size", "a.png is 40 x 48", "b.png is 30 x 48"]),
    "nothing but NaN": (stored(lambda f: f * np.nan), ["frame 0 is 100% NaN", "data.frames"]),
    "no frame but one that is not NaN": (all_but_one_are(np.nan), ["frame 1 is 100% NaN"]),
    "no frame but one that is not constant": (all_but_one_are(7.0), ["frame 1 is 7 everywhere"]),
    "identical frames": (stored(lambda f: f[[0, 0, 0]]), ["do not move", "cannot be separated", "3 to 10 px"]),
    "a camera at rest": (
        stored(lambda f: f[[0, 0, 0]] + RNG.normal(0, 3, f.shape)),
        ["do not move", "cannot be separated", "3 to 10 px"],
    ),
    "unrelated frames": (stored(lambda f: RNG.normal(8000, 300, f.shape)), ["only 1 of 3 frames register"]),
}


RUN = ("run", "nuc", "threads=1", "solver.max_iterations=3")


@pytest.mark.parametrize("what", DATA)
def test_data(what, refused, folder, burst):
    make, expected = DATA[what]
    refused((*RUN, f"data.path={make(burst.frames, folder)}"), *expected)


#: Settings, of which those that belong together are parted by `&`.
SETTINGS = {
    # keys and values
    "sede=3": ["'sede=3'", "no option 'sede'", "did you mean 'seed'", "threads"],
    "mean=5": ["no option 'mean'; allowed: data"],
    "motion=shift": ["no option 'motion'", "did you mean 'physics.warp.motion'"],
    "sensor.gain=1": ["no option 'sensor'", "did you mean 'physics.sensor'"],
    "data.pth=x": ["no option 'data.pth'", "did you mean 'data.path'"],
    "solver.max_iterations=abc": ["solver.max_iterations = 'abc'", "a whole number is needed"],
    "solver.max_iterations=-1": ["greater than or equal to 0"],
    "seed=1.5": ["seed = 1.5", "a whole number"],
    "seed=": ["value is missing", "seed=null"],
    "seed=[": ["not a YAML value"],
    "seed": ["'seed'", "key=value"],
    "burst.npz": ["key=value", "did you mean data.path=burst.npz?"],
    "noise=loud": ["'auto' or a mapping with read, photons"],
    "noise={red: 3}": ["no option 'noise.red'", "did you mean 'noise.read'"],
    "solver=fast": ["a mapping with max_iterations, plan"],
    "solver.plan=[{name: a, steps: [{group: [scen]}]}]": ["no unknown 'scen'", "did you mean 'scene'"],
    "solver.plan=[{name: a, steps: [{group: [scene], metod: adam}]}]": ["metod", "did you mean 'method'"],
    # components
    "method=averge": ["method: ", "did you mean 'average'", "joint"],
    "method=[1]": ["method = [1]: text or a mapping is needed"],
    "problem=nuk": ["problem: ", "did you mean 'nuc'"],
    "prior=tvv": ["prior: ", "did you mean 'tv'"],
    "fidelity=gausian": ["fidelity: ", "did you mean 'gaussian'"],
    "prior=grid & scene.fit.iteration=3": ["scene.fit", "iterations"],
    "prior=grid & scene.init=noise": ["scene.init", "'tv'"],
    "scene.type=os.system": ["scene: no field is called 'os.system'", "pixels"],
    "scene.width=3": ["scene (field 'pixels'): no option 'width'"],
    "scene.init=zero": ["scene.init = 'zero'"],
    "scene.penalties=tv": ["scene.penalties = 'tv'", "scene.penalties.tv="],
    "scene.penalties.tvv.weight=1": ["scene.penalties.tvv", "did you mean 'tv'"],
    "scene.penalties.tv.wieght=1": ["scene.penalties.tv", "did you mean 'weight'"],
    "scene.penalties.tv.weight=big": ["scene.penalties.tv", "weight = 'big': a number is needed"],
    "physics.warp.motion=rigit": ["physics.warp.motion: ", "did you mean 'rigid'"],
    "physics.warp.motion=null": ["physics.warp.motion: missing"],
    "physics.sensor.gian=1": ["physics.sensor: no 'gian'", "did you mean 'gain'"],
    "physics.sensor.gain=colum+row": ["physics.sensor.gain.colum", "did you mean 'column'"],
    "physics.sensor.gain.pixel.sigm=1": ["physics.sensor.gain.pixel", "did you mean 'sigma'"],
    "physics.sensor.gain=drift": ["physics.sensor.gain: ", "one value for each frame"],
    "prior=drift": ["scene: ", "one value for each frame"],
    "prior=dct": ["scene: 'dct' draws nothing but one level", "sigma"],
    "prior=constant": ["scene: 'constant' draws nothing but one level"],
    "physics.sensor.gain=true": ["physics.sensor.gain = True", "'type'"],
    "physics.sensor.gain.fixed=maybe": ["physics.sensor.gain.fixed = 'maybe'"],
    "physics.sensor.gain.init=[1]": ["physics.sensor.gain.init = [1]"],
    "physics.sensor.gain={type: constant, init: gain.npy}": ["physics.sensor.gain.init", "physics.sensor.gain.path"],
    "physics.sensor.gain={type: constant, path: no.npy}": ["physics.sensor.gain: ", "no.npy: no such file"],
    # stages
    "physics.senser.gain=1": ["physics.senser: not a stage", "did you mean 'sensor'", "before"],
    "physics.senser=null": ["no 'senser' to remove", "did you mean 'sensor'"],
    "physics.foo.before=sensor": ["physics.foo: no operator", "blur"],
    "physics.blur={before: senor}": ["physics.blur.before: no stage 'senor'", "did you mean 'sensor'"],
    "physics.sensor=null & physics.blur.before=sensor": ["physics.blur.before: no stage 'sensor'", "warp"],
    "physics.downsample={before: sensor, factor: two}": ["physics.downsample", "factor = 'two'"],
    "physics.warp=shift": ["physics.warp = 'shift': a mapping is needed"],
    # data
    "data.crop=[0,100,0,10]": ["data.crop: ", "not inside the frame of 40 x 48 px"],
    "data.crop=0,40,0,48": ["data.crop = '0,40,0,48': a list [...] of whole numbers"],
    "data.crop=[0,40]": ["data.crop: [0, 40] must be four numbers"],
    "data.frames=0:99": ["does not fit its 3 frames"],
    "data.key=frame": ["no array 'frame'", "frames"],
    "data.mask=mask.npy": ["the mask is 10 x 12 px", "40 x 48 px"],
    "data.mask=none.npy": ["none.npy: no such file"],
    "data.truth=none.npz": ["none.npz: no such file"],
    # machine and folder
    "device=gpu": ["device: 'gpu' cannot be used here", "there is cpu"],
    "output.dir=burst.npz": ["output.dir: ", "is a file"],
    "output.dir=burst.npz/a": ["output.dir: ", "cannot be written"],
    "output.dir=/proc/none": ["output.dir: /proc/none cannot be written"],
}


@pytest.mark.parametrize("setting", SETTINGS)
def test_setting(setting, refused, folder):
    np.save("mask.npy", np.zeros((10, 12)))
    refused((*RUN, "data.path=burst.npz", *setting.split(" & ")), *SETTINGS[setting])


def test_a_device_that_is_absent(refused):
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    refused((*RUN, "data.path=burst.npz", "device=cuda"), "device: 'cuda' cannot be used here", "there is cpu")


YAML = {
    "physics: {warp: [\n": ["broken YAML", "line 2"],
    "- a\n": ["a mapping of keys to values"],
    "prior: tv\nprior: tv\n": ["key 'prior' twice"],
    "prior: tv\n": ["physics is missing"],
    "physics: {warp: {}}\nprio: tv\n": ["no option 'prio'", "did you mean 'prior'"],
    "physics: !!python/name:os.system\n": ["broken YAML"],
}


@pytest.mark.parametrize("content", YAML)
def test_a_broken_configuration(content, refused, folder):
    (folder / "my.yaml").write_text(content)
    refused(("run", "my.yaml", "data.path=burst.npz"), "my.yaml", *YAML[content])


COMMANDS = {
    "rn nuc": ["No such command 'rn'", "Did you mean 'run'"],
    "nuc": ["did you mean `deepir run nuc`"],
    "help": ["all commands: deepir --help"],
    "correct": ["Missing argument 'FILE'; `deepir correct --help`"],
    "list fieldz": ["no kind and no component is called 'fieldz'; did you mean 'fields'?"],
    "run": ["Missing argument"],
    "run nuk": ["no configuration 'nuk'", "did you mean 'nuc'"],
    "run my.yaml": ["no configuration 'my.yaml'"],
    "run burst.npz": ["not a configuration", "deepir run nuc data.path=burst.npz"],
    "run nuc": ["data.path is missing"],
    "run nuc --seed 3": ["No such option: --seed", "seed=..."],
    "run nuc --out folder": ["No such option: --out", "output.dir=FOLDER"],
    "run nuc path=burst.npz": ["no option 'path'", "did you mean 'data.path'?"],
    "run nuc data.path=burst.npz --plugin nope": ["plugin 'nope' cannot be imported"],
    "run nuc data.path=burst.npz --plugin broken": ["plugin 'broken' cannot be imported: division by zero"],
    "resume": ["Missing argument"],
    "resume nope": ["nope: no run in this folder"],
    "check brust.npz": ["no such file", "did you mean 'burst.npz'"],
    "run nuc method=average uncertainty.samples=8 data.path=burst.npz": ["no posterior to draw from"],
    "check nuc sede=3": ["did you mean 'seed'"],
    "check burst.npz seed=3": ["settings go with a configuration"],
    "simulate out.txt": ["out.txt", ".npz"],
    "simulate none/out.npz": ["a folder that exists"],
    "simulate burst.npz": ["burst.npz exists", "--overwrite"],
    "simulate out.npz n_frame=3": ["simulate: no option 'n_frame'", "did you mean 'n_frames'"],
    "simulate out.npz n_frames=many": ["n_frames = 'many': a whole number"],
    "simulate out.npz n_frames=100000000": ["simulate: 3.07e+12 samples", "at most"],
    "simulate out.npz max_shift=1e9": ["simulate.max_shift = 1000000000.0: at most 2000 px"],
    "simulate out.npz motion=rigit": ["did you mean 'rigid'"],
    "simulate out.npz kind=pan n_frame=3": ["did you mean 'n_frames'"],
    "simulate out.npz kind=pan --scene camera": ["--scene"],
    "simulate out.npz --scene none.png": ["none.png: no such file"],
    "capture taken.npz --camera v4l": ["no camera is called 'v4l'; did you mean 'v4l2'?"],
    "capture taken.npz devise=/dev/video2": ["no option 'devise'; did you mean 'device'?"],
    "capture taken.npz --frames 0": ["'--frames': Input should be greater than or equal to 1"],
    "capture burst.npz": ["burst.npz exists; replace it with --overwrite"],
    # maps
    "apply maps.npz": ["Missing argument 'FILE'"],
    "apply nowhere.npz burst.npz": ["nowhere.npz: no such file"],
    "apply burst.npz burst.npz": ["burst.npz: no gain and no offset; maps are made by `deepir calibrate`"],
    "apply maps.npz nowhere.npz": ["nowhere.npz: no such file"],
    "apply maps.npz small.npy": ["the frames are 20 x 20 px, the maps 40 x 48 px"],
    "apply maps.npz burst.npz --output maps.npz": ["maps.npz exists; replace it with --overwrite"],
    "apply maps.npz burst.npz --output ./burst.npz --overwrite": ["burst.npz is the recording itself"],
    "apply maps.npz burst.npz --output a.avi": ["a.avi: a recording is written as .tif"],
    "apply maps.npz burst.npz --output nowhere/a.tif": ["cannot be written"],
    "apply maps.npz burst.npz prior=tv": ["prior=tv: only settings of data.key, data.raw"],
    "apply maps.npz burst.npz data.frames=9:": ["names no frames of the recording", "counted from the start"],
    "apply maps.npz burst.npz output.palette=iron": ["'white-hot' or 'black-hot' or 'ironbow'"],
    "calibrate maps.npz burst.npz": ["maps.npz exists; replace it with --overwrite"],
    "calibrate a.tif burst.npz": ["give a file name that ends in .npz"],
    "calibrate a.npz burst.npz small.npy": ["flat frames differ in size"],
    "calibrate a.npz small.npy small.npy": ["two temperatures are needed"],
    "calibrate a.npz --burst burst.npz small.npy": ["2 recordings given: one with --burst"],
    "calibrate a.npz data.key=frames": ["0 recordings given"],
    "calibrate a.npz burst.npz seed=1": ["seed=1: only settings of data.key, data.raw"],
    # frames as they come
    "live": ["give a recording, or a camera"],
    "live small.npy --camera v4l2": ["give a recording, or a camera"],
    "live -": ["data.raw.width"],
    "live smal.npy": ["no such file"],
    "live small.npy solver.max_iterations=3": ["only settings of"],
    "live small.npy --maps nowhere.npz": ["nowhere.npz"],
    "live small.npy --output out.avi": ["written as .tif"],
    "live --camera boson5": ["boson5"],
    "live small.npy --port 9000": ["add --page"],
    "live small.npy --record-to films": ["--record-to is an option of the page"],
    # how much motion
    "analyze nothing.npz": ["nothing.npz: no such file"],
    "analyze small.npy seed=3 --flat": ["seed=3: only settings of data are accepted here"],
    "analyze burst.npz sed=3": ["did you mean 'seed'"],
    "analyze small.npy --flat --output small.npy": ["ends in .png"],
    "analyze small.npy --flat --output mine.png": ["mine.png exists", "--overwrite"],
    # sweeps
    "compare nuc data.path=burst.npz": ["nothing varies", "prior=tv,dip"],
    "compare nuc data.path=burst.npz data.frames=3,9": ["data.frames=9", "does not fit its 3 frames"],
    "compare nuc data.path=burst.npz prior=tv,tv": ["prior=tv,tv: nothing varies, tv is listed 2 times"],
    "compare nuc data.path=burst.npz prior=tv,red data.crop=[0,999,0,9]": ["error: data.crop: "],
    "compare nuc data.path=burst.npz prior=tv,red fidelity=l3": ["error: fidelity: no fidelity is called 'l3'"],
    "compare nuc data.path=burst.npz output.dir=a,b": ["output.dir", "one folder"],
    "compare nuc seed=0,1": ["data.path is missing"],
    "compare nuc --seed 0,1": ["No such option: --seed", "seed=..."],
    "compare nuk seed=0,1": ["did you mean 'nuc'"],
    "batch nuc none*.npz": ["none*.npz: no such file"],
    "batch nuc seed=0": ["no burst", "bursts/*.tiff"],
    "batch nuc burst.npz data.path=burst.npz": ["data.path: ", "without it"],
    "batch nuc burst.npz prior=tvv": ["did you mean 'tv'"],
    "batch nuc burst_truth.npz": ["burst_truth"],
    "--vresion": ["No such option: --vresion", "--version"],
}


@pytest.mark.parametrize("line", COMMANDS)
def test_command(line, refused, folder):
    if line.startswith(("compare", "batch")):
        pytest.importorskip("distributed")
    size = (40, 48)
    np.savez("maps.npz", gain=np.ones(size), offset=np.zeros(size), bad_pixels=np.zeros(size, bool))
    np.save("small.npy", RNG.integers(0, 99, (2, 20, 20), np.uint16))
    (folder / "mine.png").write_bytes(b"mine")
    (folder / "broken.py").write_text("1 / 0")
    refused(line.split(), *COMMANDS[line])
