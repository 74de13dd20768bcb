"""The schema of a configuration; options of components follow from their constructors: `deepir.config.components`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Palette = Literal["white-hot", "black-hot", "ironbow", "inferno", "magma", "turbo"]
Tones = Literal["percentile", "clahe"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", coerce_numbers_to_str=True)  # a folder may be called 2021


class Raw(_Strict):
    """Layout of a recording without a header."""

    width: int = Field(ge=1, le=2**15)  # px
    height: int = Field(ge=1, le=2**15)  # px
    bits: int = Field(16, ge=1, le=16)  # that count; up to 8 take one byte a sample, more take two
    #: Of a sample; None: unsigned, of one or two bytes by `bits`.
    type: Literal["uint8", "uint16", "int16", "uint32", "int32", "float32", "float64"] | None = None
    offset: int = Field(0, ge=0)  # bytes before the first frame
    gap: int = Field(0, ge=0)  # bytes between frames
    trailer: int = Field(0, ge=0)  # bytes after the last frame
    endian: Literal["little", "big"] = "little"


class Radiometry(_Strict):
    """Conversion of counts to kelvin, see `deepir.io.radiometry`; None: as in the file."""

    scale: float | None = Field(default=None, gt=0)  # kelvin a count: 0.01 for TLinear
    zero: float | None = None  # kelvin at zero counts
    r1: float | None = Field(default=None, gt=0)  # Planck's law, in FLIR's constants
    b: float | None = Field(default=None, gt=0)
    f: float | None = None
    o: float | None = None
    r2: float | None = Field(default=None, gt=0)
    emissivity: float | None = Field(default=None, gt=0, le=1)  # of the surface
    reflected: float | None = Field(default=None, gt=0)  # K, of the surroundings
    transmission: float | None = Field(default=None, gt=0, le=1)  # of the air
    atmosphere: float | None = Field(default=None, gt=0)  # K
    window_transmission: float | None = Field(default=None, gt=0, le=1)
    window: float | None = Field(default=None, gt=0)  # K


class Data(_Strict):
    """Source of the frames."""

    path: str | None = None  # file, folder or glob
    simulate: dict[str, Any] | None = None  # in place of a path; `deepir.simulate.burst` checks it
    truth: str | None = None  # .npz with `scene`, or a picture: scores are added to metrics.json
    mask: str | None = None  # picture or array of a frame's size; nonzero = ignore
    crop: list[int] | None = None  # [y0, y1, x0, x1], applied to frames and mask
    frames: str | int | list[int] | None = None  # the first n, a slice a:b, or a list
    key: str | None = None  # array in a file that holds several
    axes: Literal["nhw", "nwh", "hwn", "whn", "hnw", "wnh"] | None = None  # of an array: frames n, height h, width w
    swap_bytes: bool | None = None  # the bytes of each sample; None: as stored, and an error where they look swapped
    raw: Raw | None = None  # layout of a file without a header
    radiometry: Radiometry = Radiometry()
    fps: float | None = Field(default=None, gt=0)  # frames a second


class Noise(_Strict):
    """Noise of a sample: variance `read² + y / photons`."""

    read: float = Field(ge=0, le=1e15)  # standard deviation, in the data's units
    photons: float | None = Field(None, ge=1e-15)  # photons for each unit of data; None: no photon noise


class DataSet(_Strict):
    """A further data set of a problem: another camera, another burst, a flat, see `deepir.joint_problem`."""

    data: Data = Data()
    physics: dict[str, dict[str, Any] | None] | None = None  # None: those of the first data set
    scene: Literal["shared", "own"] = "shared"  # with the first data set
    noise: Literal["auto"] | Noise = "auto"


class StepConfig(_Strict):
    """A step of a stage, see `deepir.schedule.Step`."""

    group: list[str] = Field(min_length=1)
    method: str = "lbfgs"  # an optimiser: `lbfgs`, `adam`, one of a plugin; or `eliminate`, in closed form
    lr: float = Field(1e-2, gt=0)
    rates: dict[str, Annotated[float, Field(gt=0)]] = {}  # for unknowns whose lr is another
    every: int = Field(1, ge=1)
    average: float = Field(0.0, ge=0, lt=1)  # of adam's iterates: the decay


class Fit(_Strict):
    """`scene.fit`: how a prior is fitted to the scene once the sensor is known."""

    method: str = "adam"  # an optimiser
    lr: float = Field(1e-2, gt=0)
    iterations: int = Field(300, ge=0)  # of each round
    rounds: int = Field(1, ge=1, le=1000)  # at whose begin penalties learn from the scene what they need
    average: float = Field(0.0, ge=0, lt=1)
    with_sensor: bool = False  # gain and offset follow the scene, where they have a closed form


class StageConfig(_Strict):
    """A stage of the plan, see `deepir.schedule.Stage`."""

    name: str
    steps: list[StepConfig] = Field(min_length=1)
    iterations: int = Field(100, ge=0)


class Solver(_Strict):
    """Iterations and stages of the solve."""

    max_iterations: int | None = Field(default=None, ge=0)  # caps each stage
    plan: list[StageConfig] | None = Field(default=None, min_length=1)  # None: the problem's own


class Uncertainty(_Strict):
    """How standard deviations of the unknowns are found."""

    samples: int | None = Field(default=None, ge=2, le=10**4)  # of the posterior; None: formulas


class Output(_Strict):
    """Folder and format of the results."""

    dir: str | None = None
    palette: Palette = "white-hot"
    tones: Tones = "percentile"
    mat: bool = False  # result.mat beside result.npz


class Config(_Strict):
    """A whole configuration; the components check `physics`, `scene`, `fidelity` and `method`."""

    problem: str = "generic"
    method: str | dict[str, Any] = "joint"
    prior: str = "tv"
    scene: dict[str, Any] = {}
    physics: dict[str, dict[str, Any] | None]
    fidelity: str | dict[str, Any] = "gaussian"
    noise: Literal["auto"] | Noise = "auto"
    data: Data = Data()
    #: Further data sets by name; their slots may name an unknown of those before: `{unknown: gain}`.
    datasets: dict[str, DataSet] = {}
    #: Effects by name: false leaves one out; a mapping sets its options.
    effects: dict[str, bool | dict[str, Any] | None] = {}
    solver: Solver = Field(default_factory=Solver)
    uncertainty: Uncertainty = Uncertainty()
    output: Output = Output()
    seed: int = Field(0, ge=0, lt=2**63)
    device: str = "cpu"
    threads: int | None = Field(None, ge=1, le=1024)

    def sources(self) -> dict[str, Data]:
        """The data of all data sets, by where they stand."""
        return {"data": self.data} | {f"datasets.{name}.data": each.data for name, each in self.datasets.items()}
