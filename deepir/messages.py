"""Messages on a result: their names, what they mean and what to do. `docs/reference/messages.md` lists them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

MAX_SHOWN = 5  # messages that a command prints; the others are in the report

#: Name -> what it means, what to do; the most important first. A part of the result is wrong or uncertain.
WARNINGS = {
    "scene-in-pattern": (
        "The estimated pattern looks like a picture, so the estimated motion is wrong. Scene and pattern are mixed up.",
        "Do not use the result. Take the burst again with 3 to 10 px between frames, in x and in y. Mask what stands "
        "still in front of the camera with `data.mask`.",
    ),
    "motion-not-trusted": (
        "The estimated motion explains the frames little better than rest, so the result is the first frame as it is.",
        "Take the burst again before a scene with varied detail, with 3 to 10 px between frames.",
    ),
    "scene-repeats": (
        "The scene repeats itself, as a fence does, so frames match at many displacements.",
        "Take another scene, or move by less than half a period between frames.",
    ),
    "equalised-frames": (
        "The camera has equalised the histogram of each frame, so its values are ranks. Gain, offset and contrasts of "
        "the scene have no physical meaning.",
        "Record the raw stream of 14 or 16 bits, or switch the camera to a linear gain.",
    ),
    "frames-not-registered": (
        "No single motion explains the frames, but parts of them move. The offset was estimated without registration, "
        "and the scene is the corrected first frame.",
        "Of a recording, `deepir correct` uses all frames. Or take the burst again with a smoother motion. For near "
        "and far objects try `deepir run flow`.",
    ),
    "correction-replaced": (
        "A simpler correction leaves less fixed pattern than the estimated one, so the result has the simpler one.",
        "Take more frames and more motion, or use `deepir correct` on the whole recording.",
    ),
    "motion-small": (
        "The camera moves too little along one axis. The pattern of the columns (x) or rows (y) stays in the scene, or "
        "takes from it.",
        "Take the burst again, with 3 to 10 px between frames along both axes.",
    ),
    "motion-along-a-line": (
        "All frames lie along one line. What is constant along that line may be pattern or scene.",
        "Move the camera in a circle.",
    ),
    "motion-about-a-point": (
        "The camera only turns about one point. What is constant around that point may be pattern or scene.",
        "Shift the camera too, in x and in y.",
    ),
    "sensor-left-neutral": (
        "The frames do not move, so gain and offset cannot be separated from the scene. Both are left neutral.",
        "Correct the frames first with `deepir apply`, or give a burst that moves.",
    ),
    "one-frame": (
        "With one frame only smoothness separates stray flux from the scene. A slope or a large glow of the scene "
        "counts as stray flux.",
        "Take five frames or more while the camera moves.",
    ),
    "frames-alike": (
        "The frames show almost the same scene. What all of them show at one place counts as pattern.",
        "Take frames further apart, with `data.frames=::10`, or use `deepir run nuc`.",
    ),
    "interlaced-frames": (
        "Odd and even rows were exposed at different times, and the camera moved in between.",
        "Record progressive frames, or keep every second row.",
    ),
    "shutter-in-burst": (
        "The fixed pattern changes within the burst, as where a shutter closes. Only the longer part is used.",
        "Nothing if the part has frames enough. Otherwise switch the automatic shutter off and take the burst again.",
    ),
    "drawn-pixels": (
        "Pixels hold one value in all frames: text or marks that the camera draws, or clipped pixels.",
        "Switch the overlay off, or leave it out with `data.mask` or `data.crop`.",
    ),
    "torn-frames": (
        "A frame is composed of two exposures, above and below a row. It fits neither of them.",
        "Leave these frames out with `data.frames`; check the cable or the frame grabber.",
    ),
    "thermal-lag": (
        "Each frame still shows some of the one before, as with slow pixels. Edges have tails.",
        "Move more slowly, or rest before each frame. For an even motion use `deepir run deblur_lag data.fps=...`.",
    ),
    "rows-displaced": (
        "The camera shakes while a frame is read out row by row, so rows are displaced, and the scene is blurred.",
        "Hold the camera more firmly or move it more slowly. Operator `rolling_shutter` models an even motion.",
    ),
    "subpage-frames": (
        "The camera reads its pixels in two halves, as on a chessboard, and moves in between.",
        "Move more slowly, or rest before each frame.",
    ),
    "unsharp-frames": (
        "Some frames are less sharp than others, by autofocus or by fast motion.",
        "Leave them out with `data.frames`, or model each frame's blur with `per_frame` of operator `blur`.",
    ),
    "frames-bend": ("The camera zooms or tilts, or has a wide lens.", "Set `physics.warp.motion.type=auto`."),
    "parallax": (
        "Near and far parts of the scene move by different amounts, which one motion of the frame does not follow.",
        "Use `deepir run flow`.",
    ),
    "shading-changes": (
        "Something smooth changes from frame to frame: clouds, stray flux, the temperature of the housing.",
        "Take the frames faster. Trust slow parts of the scene less than their deviation says.",
    ),
    "still-region": (
        "A part of the picture does not follow the scene: a bonnet, a mount, a barrel, or pixels that do not respond.",
        "Nothing, if it is what you expect. A mask (`data.mask`) or a crop (`data.crop`) is surer.",
    ),
    "pattern-cost": (
        "The unknown pattern costs precision: the scene has this much more noise than with a known sensor.",
        "Take more frames, or move further in x and in y.",
    ),
    "shading-not-separated": (
        "The frames are shaded, but they are too few to separate shading from the scene. It stays in the scene.",
        "Take as many frames as the message says, with more motion.",
    ),
    "shading-guessed": (
        "No two frames show the same things. The sensor's shading was separated from the scenes only statistically.",
        "Use neighbouring frames of a moving camera.",
    ),
    "shading-implausible": (
        "The shading that all frames share is too strong for a sensor with so weak a fine pattern. It is left "
        "to the scenes.",
        "Take frames of different scenes, with a camera that turns.",
    ),
    "shading-stays": (
        "The shading of the fixed pattern was not separated from the scenes and stays. Rows, columns and pixels are "
        "corrected. Do not compare distant parts of a picture.",
        "Where you see shading: Turn the camera both ways, sideways and up and down.",
    ),
    "camera-turns-one-way": (
        "The camera turned along one axis only: shading along the other one was not separated from the scene, and was "
        "left as it was.",
        "Turn the camera sideways, and tilt it too.",
    ),
    "few-frames": (
        "A few frames hardly separate the pattern of single pixels from the scenes.",
        "Take as many frames as the message says.",
    ),
    "few-frames-for-factor": (
        "The scene has more pixels than the frames have samples. Fine detail comes in part from the prior.",
        "Take more frames, or a smaller `physics.downsample.factor`.",
    ),
    "level-drift-ignored": (
        "The level of whole frames drifts, and this configuration does not estimate it.",
        "Set `physics.sensor.level=drift`.",
    ),
    "level-drift": (
        "The level of whole frames drifts: the camera warms up, or corrects itself. It is estimated, but a slope "
        "across the scene is uncertain.",
        "Let the camera warm up, and switch its own correction off.",
    ),
    "contrast-varies": (
        "The contrast differs from frame to frame, as with an automatic gain. It is evened out, but values are not "
        "radiometric.",
        "Record with a fixed gain, 14 or 16 bits.",
    ),
    "unseen-pixels": (
        "No frame shows a part of the scene. Its values go on smoothly from what is beside it. `unseen` in "
        "`result.npz` marks it.",
        "Do not measure there, or take frames that show it.",
    ),
    "network-without-fit": (
        "A network that draws the scene moves by L-BFGS together with the sensor. Much of the contrast can end in the "
        "gain.",
        "Fit the network once the sensor is known, with `scene.fit` as the message says.",
    ),
    "clipped-samples": (
        "Samples lie at an end of the camera's range. There the scene is a bound and not a value; `clipped` in "
        "`result.npz` marks it.",
        "Choose a wider range or a shorter integration time.",
    ),
    "noise-below-rounding": (
        "The given noise is smaller than rounding to whole counts allows. The units do not fit.",
        "Give `noise.read` in the data's units, or `noise=auto`.",
    ),
    "lag-motion-fast": (
        "The camera moves too far between two frames for the sub-steps of the lag model.",
        "Set `physics.lag.substeps` as the message says, or move more slowly.",
    ),
    "lag-first-frame": (
        "The first frame does not fit: the camera did something else before it. Its tail is in the next frames.",
        "Try the value that the message names, or leave the first frames out with `data.frames=2:`.",
    ),
    "blur-width-unknown": (
        "The spectrum of the frames shows no width of the blur, so almost none is removed.",
        "Give the width, with `fixed=true`, or a larger radius.",
    ),
    "blur-small": (
        "The frames are sharp already. Deconvolution gains little, and may smooth fine detail.",
        "Keep the frames as they are, or use `deepir run nuc` for a burst.",
    ),
    "truth-not-compared": (
        "The true scene has another size than the result, so there are no scores.",
        "Give a truth on the grid of the result.",
    ),
    "motion-uncertain": (
        "The frame agrees with the others only in part. Its motion may be wrong, which blurs the scene.",
        "Nothing for one frame of eight. If most frames say so, take the burst over something with edges.",
    ),
}
#: The same of what the result takes into account already.
NOTES = {
    "moving-object": (
        "Something moves by itself, and is left out of the estimate. Of a burst, `moving` in `result.npz` shows it.",
        "Nothing, unless it covers a place in most frames. Then mask it with `data.mask`.",
    ),
    "line-noise": ("Whole rows or columns jump from frame to frame. The jumps are estimated and removed.", "Nothing."),
    "response-drift": (
        "The response of the camera changes from frame to frame. It is estimated and evened out.",
        "Nothing. Let the camera warm up before you measure.",
    ),
    "telemetry-rows": (
        "Rows hold numbers and no picture, as with telemetry. They are left out.",
        "Nothing, or cut them off with `data.crop` as the message says.",
    ),
    "reference-frame": (
        "The first frame is left out, so motions and results refer to a later one.",
        "Nothing, but compare the scene with that frame.",
    ),
    "frame-not-registered": (
        "A frame does not fit the others and is left out: another place, or something large in front.",
        "Nothing for one frame of eight. For many, check that the burst shows one scene.",
    ),
    "frame-repeated": (
        "A frame brings nothing new: it repeats the one before it, or shows the shutter. It is left out.",
        "Nothing. Repeats mean that the recorder is faster than the camera.",
    ),
    "frame-empty": (
        "A frame has no picture and is left out. The other frames are counted without it.",
        "Nothing for a single one. Else check the recording with `deepir check FILE`.",
    ),
    "frame-interpolated": (
        "A frame does not register. Its motion is interpolated, because the next frames depend on it.",
        "Nothing for a single one. For more, take the burst again.",
    ),
}
#: Warnings after which the result is not to be used.
DISTRUSTED = ("scene-in-pattern", "motion-not-trusted", "scene-repeats", "equalised-frames")
IMPORTANCE = {name: place for place, name in enumerate([*WARNINGS, "", *NOTES])}


class Message(str):
    """A message on a result: its text, and the name under which it is explained."""

    __slots__ = ("name",)
    name: str

    def __new__(cls, name: str, text: str) -> Message:
        """A message with a name."""
        found = super().__new__(cls, text)
        found.name = name
        return found

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return self.name, str(self)


def within(message: str, where: str) -> str:
    """A message with the place that it is of."""
    text = f"{where}: {message}"
    return Message(message.name, text) if isinstance(message, Message) else text


def labelled(messages: Iterable[str]) -> list[str]:
    """Messages with severity and name, the most important first; those of plugins may have no name.

    >>> labelled(["too dark", Message("line-noise", "rows jump"), Message("motion-small", "it stands still")])
    ['warning[motion-small]: it stands still', 'warning: too dark', 'note[line-noise]: rows jump']
    """
    return [
        f"{'note' if name in NOTES else 'warning'}{f'[{name}]' if name else ''}: {text}"
        for name, text in by_importance(messages)
    ]


def by_importance(messages: Iterable[str]) -> list[tuple[str, str]]:
    """Names and texts of messages, the most important first; those of plugins may have no name, ""."""
    named = [(getattr(each, "name", ""), str(each)) for each in messages]
    return sorted(named, key=lambda pair: IMPORTANCE.get(pair[0], IMPORTANCE[""]))


def shown(lines: Sequence[str], elsewhere: str) -> list[str]:
    """The lines that a command prints, and how many more are `elsewhere`."""
    more = len(lines) - MAX_SHOWN
    return [*lines[:MAX_SHOWN], *([f"and {more} more: see {elsewhere}"] if more > 0 else [])]
