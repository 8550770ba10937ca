"""Make a dataset: draw it, render it pose by pose, write it; a run that was stopped is continued. Home of h5py."""

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RangesConfig, RigConfig, input_hashes
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.provenance import file_sha256, provenance
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.dataset import _draws, _formats
from lightopt.dataset._draws import FUSED, SPLITS, STACK, DatasetOptions, PoseDraw, Setup
from lightopt.dataset._folder import MANIFEST, DatasetFolder
from lightopt.dataset._pose import PoseImages, PostureLimits, SampleImages, posture_limits, render_pose, sample_images
from lightopt.images import write_bytes_atomic, write_exr, write_png
from lightopt.rendering import cast_rays_at, refuse_unusable_scene
from lightopt.scene import at_rest_warnings, build_catalogue, defect_facts, frame_part

TAKEN = (FUSED, STACK, "poses", "stacks")  # names that no light may have


@dataclass(frozen=True, kw_only=True)
class DatasetResult:
    """What :func:`make_dataset` left on disk."""

    # number of samples, and of images under single lights
    samples: int
    images: int
    # number of poses, and of those that a previous run had finished
    poses: int
    resumed: int
    # number of defects, and of those that all images of their sample together can show
    defects: int
    visible: int
    files: tuple[Path, ...]


def make_dataset(
    rig: RigConfig,
    part: PartConfig,
    folder: Path,
    *,
    options: DatasetOptions,
    ranges: RangesConfig | None = None,
    force: bool = False,
    run: RunContext | None = None,
) -> DatasetResult:
    """Render a labelled training set of a part for detectors of its catalogue's defects.

    A pose is a placement of the part in one of its postures. It is rendered once, and several samples share it, each
    with its own defects, dust, reflectance, gains and noise. The same inputs give the same bytes.

    ranges: What is randomised; :class:`lightopt.config.RangesConfig` has the defaults.
    run: Its stages are poses.
    Raises InputError: whatever is wrong with files, options, ranges or folder
    """
    run = run or RunContext()
    ranges = ranges or RangesConfig(format="lightopt-ranges/1")
    problems = options.problems()
    problems += [
        f"{rig.source.at('lights', i)}: a dataset has a folder {light.name}; give the light another name"
        for i, light in enumerate(rig.lights)
        if light.name.lower() in TAKEN
    ]
    refuse(problems)
    if options.stacks:
        require_h5py()
    setup = Setup(rig, part, options, ranges, _draws.factors_of(ranges, rig, part), build_catalogue(part), run.threads)
    inputs: dict[str, Any] = dict(input_hashes(rig, part))
    if ranges.fit is not None:
        inputs["fit"] = {"sha256": file_sha256(ranges.source.resolve(ranges.fit))}
    made_from = provenance(inputs, {**asdict(options), "ranges": ranges.model_dump(mode="json")})
    names = [*setup.views, "poses", "stacks", "samples.csv", "datasheet.md"]
    out = DatasetFolder(folder, made_from, names=names, force=force)
    if (complete := out.complete) is not None:
        return _result(folder, complete, resumed=int(complete["poses"]))
    scene = setup.scene
    refuse_unusable_scene(scene, rig, part, cast_rays_at(scene))
    run.warn(*scene.warnings, *at_rest_warnings(scene, options.exposure))
    poses = _draws.draw_poses(setup)
    splits = Counter(pose.split for pose in poses)
    remedy = "more samples, or fewer samples per pose, help"
    if empty := [name for name in SPLITS if getattr(ranges.split, name) > 0.0 and not splits[name]]:
        run.warn(f"{counted(len(poses), 'pose')}: none is in the split {' or '.join(empty)}; {remedy}")
    shown = {pose.posture for pose in poses}
    if unshown := [str(posture) for posture in scene.postures if posture not in shown]:
        run.warn(f"no sample is in posture {', '.join(unshown)}; {remedy}")
    out.begin(setup.views)
    limits: dict[Any, PostureLimits] = {}
    before = {pose.number: record for pose in poses if (record := out.record(pose.number)) is not None}
    records: list[dict[str, Any]] = []
    stage = run.stage("rendering poses")
    for pose in poses:
        if (record := before.get(pose.number)) is None:
            if pose.posture not in limits:
                limits[pose.posture] = posture_limits(setup, pose.posture)
            record = _make_pose(setup, out, pose, limits[pose.posture])
        records.append(record)
        stage((pose.number + 1) / len(poses))
    samples = [sample for record in records for sample in record["samples"]]
    if cut_off := [record["pose"] for record in records if record["leaves_view"]]:
        where = f"{counted(len(cut_off), 'pose')} of {len(poses)}, as in pose {cut_off[0]}"
        run.warn(f"the part leaves the view in {where}; lower shift_mm of the ranges, or let the camera see more")
    if omitted := sum(record["omitted"] for record in records):
        run.warn(f"{counted(omitted, 'defect')} left out: no image shows all of it; use a catalogue of smaller ones")
    files = _formats.write_formats(out, setup, samples)
    out.write_text("datasheet.md", _formats.datasheet(setup, samples, omitted))
    defects = [one for sample in samples for one in sample["defects"]]
    found = {
        "views": list(setup.views),
        "samples": len(samples),
        "images": len(samples) * len(setup.lights),
        "poses": len(poses),
        "defects": len(defects),
        "visible": sum(one["visibility"][STACK]["visible"] for one in defects),
        "omitted": omitted,
        "files": [*files, "datasheet.md"],
    }
    out.finish(found)
    return _result(folder, found, resumed=len(before))


def _result(folder: Path, found: Mapping[str, Any], *, resumed: int) -> DatasetResult:
    numbers = {name: int(found[name]) for name in ("samples", "images", "poses", "defects", "visible")}
    files = tuple(folder / name for name in (MANIFEST, "datasheet.md", "samples.csv"))
    return DatasetResult(resumed=resumed, files=files, **numbers)


def _make_pose(setup: Setup, out: DatasetFolder, draw: PoseDraw, limits: PostureLimits) -> dict[str, Any]:
    pose = render_pose(setup, draw)

    def make(number: int) -> tuple[dict[str, Any], list[str], SampleImages | None]:
        sample = _draws.draw_sample(setup, number)
        images = sample_images(pose, sample, limits)
        defects = _defects(pose, images)
        facts: dict[str, Any] = {
            "sample": number,
            "pose": draw.number,
            "posture": draw.posture.as_dict(),
            "split": draw.split,
            "R_d_factor": round(sample.R_d, 6),
            "R_s_factor": round(sample.R_s, 6),
            "gain_factors": {name: round(gain, 6) for name, gain in zip(setup.lights, sample.gains, strict=True)},
            "particles": len(sample.dust),
            "omitted": images.omitted,
            "defects": defects,
            "files": {view: _formats.image_name(view, number, defects, draw.split) for view in setup.views},
        }
        return facts, _write_sample(setup, out, facts, images), images if setup.options.stacks else None

    found = in_threads(make, list(draw.samples), setup.threads)
    files = [f"poses/pose-{draw.number:06}.exr", *(name for _, names, _ in found for name in names)]
    geometry = pose.actual.geometry
    channels = {
        **{f"P.{axis}": geometry.points[..., i] for i, axis in enumerate("XYZ")},
        **{f"N.{axis}": geometry.normals[..., i] for i, axis in enumerate("XYZ")},
        **{f"{image.light}.Y": image.level for image in pose.view.prediction.images.lights},
    }
    write_exr(out.path(files[0]), channels, metadata=draw.as_dict())
    samples = [facts for facts, _, _ in found]
    if setup.options.stacks:
        files.append(f"stacks/pose-{draw.number:06}.h5")
        _write_stack(out.path(files[-1]), pose, samples, [images for _, _, images in found if images is not None])
    omitted = sum(facts["omitted"] for facts in samples)
    leaves = not frame_part(pose.pixels.view.camera, pose.scene.mesh).inside
    record = {**draw.as_dict(), "leaves_view": leaves, "samples": samples, "omitted": omitted, "files": files}
    out.write_record(draw.number, record)
    return record


def _defects(pose: PoseImages, images: SampleImages) -> list[dict[str, Any]]:
    width, height = pose.setup.size
    facts = defect_facts([one.placed for one in images.defects], pose.scene.placement)
    return [
        {
            **own,
            "box_px": list(_formats.box_of(one.pixels, width)),
            "visibility": {
                name: {"z": round(each.z, 3), "visible": each.visible} for name, each in one.visibility.items()
            },
            "mask": _formats.run_lengths(one.pixels, height, width),
        }
        for own, one in zip(facts, images.defects, strict=True)
    ]


def _write_sample(setup: Setup, out: DatasetFolder, facts: Mapping[str, Any], images: SampleImages) -> list[str]:
    files: list[str] = []
    shift = max(0, int(setup.scene.sensor.bit_depth) - 8)  # readers of datasets expect 8 bits
    pictures = [(levels >> shift).astype(np.uint8) for levels in images.levels]
    pictures += [] if images.fused is None else [images.fused]
    for view, picture in zip(setup.views, pictures, strict=True):
        image = facts["files"][view]
        metadata = {"sample": facts["sample"], "view": view}
        write_png(out.path(image), picture, metadata=metadata)
        files.append(image)
        if (mask := _formats.mask_name(image)) is not None:
            write_png(out.path(mask), _formats.union(facts["defects"], view, setup.size), metadata=metadata)
            files.append(mask)
        if (labels := _formats.yolo_name(image)) is not None:
            out.write_text(labels, _formats.yolo_text(facts["defects"], view, setup.kinds, *setup.size))
            files.append(labels)
    return files


def require_h5py() -> None:
    """Raise an InputError where the package that writes HDF5 is missing."""
    try:
        import h5py  # noqa: F401  # pyright: ignore[reportMissingImports, reportUnusedImport]
    except ImportError:
        raise InputError(
            "option 'stacks': needs the package h5py; install it with: pip install lightopt[hdf5]; or leave the option "
            "out"
        ) from None


def _write_stack(
    path: Path, pose: PoseImages, samples: Sequence[dict[str, Any]], images: Sequence[SampleImages]
) -> None:
    """Write the arrays of a pose, compressed image by image, whole or not at all, the same input the same bytes."""
    import h5py  # pyright: ignore[reportMissingImports]

    width, height = pose.setup.size
    labels = np.zeros((len(images), height, width), np.uint8)
    for own, one in zip(labels, images, strict=True):
        for number, defect in enumerate(one.defects, 1):
            own.reshape(-1)[defect.pixels] = number
    arrays = {
        "levels": np.stack([np.stack(one.levels) for one in images]),
        "defect": labels,
        "nominal": pose.view.predicted,
        "deviation": pose.deviation,
        "normals": np.ascontiguousarray(np.moveaxis(pose.actual.geometry.normals, -1, 0)),
    }
    if pose.setup.options.fusion:
        arrays["fused"] = np.stack([one.fused for one in images if one.fused is not None])
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["lights"] = list(pose.setup.lights)
        file.attrs["samples"] = json.dumps(samples)
        for name, values in arrays.items():
            chunk = (*np.ones(values.ndim - 2, np.intp).tolist(), *values.shape[-2:])
            file.create_dataset(
                name, data=values, chunks=chunk, compression="gzip", compression_opts=1, track_times=False
            )
    write_bytes_atomic(path, memory.getvalue())
