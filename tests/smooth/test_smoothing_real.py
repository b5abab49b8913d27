"""What smoothing is worth on real detections."""

from pathlib import Path

import numpy as np
import pytest

from phdtrack import config, pipeline
from phdtrack.formats import read_detections, read_seqinfo, read_truth
from phdtrack.metrics import Scores, evaluate, pool

SEQUENCES = (
    ("TUD-Campus", "public"),
    ("TUD-Campus", "frcnn"),
    ("KITTI-17", "public"),
    ("KITTI-17", "frcnn"),
)


def scores(data: Path, filter_name: str, *sets: str) -> Scores:
    """Of the corrected tracks of all sequences together."""
    found = []
    for name, kind in SEQUENCES:
        folder = data / "mot15" / name
        info = read_seqinfo(folder)
        table = read_detections(folder / f"det_{kind}" / "det.txt")
        stages = config.build(config.load(sets=sets), info, filter_name)
        rng = np.random.default_rng(1)
        frames = ((n, (n - 1) / info.fps, table.at(n)) for n in range(1, info.frames + 1))
        *_, (state, _) = pipeline.run(stages, frames, rng)
        found.append(
            evaluate(
                read_truth(folder / "gt" / "gt.txt"),
                pipeline.finish(stages, state),
                frames=info.frames,
            )
        )
    return pool(found)


@pytest.mark.data
@pytest.mark.parametrize("filter_name", ["gm-phd", pytest.param("mht", marks=pytest.mark.slow)])
def test_stitching_and_smoothing_each_improve_scores(data: Path, filter_name: str):
    both = scores(data, filter_name)
    apart = scores(data, filter_name, "smooth.stitching=false")
    rough = scores(data, filter_name, "smooth.smoothing=false")
    assert both.IDF1 > apart.IDF1 + 0.005
    assert both.HOTA > apart.HOTA + 0.002
    assert both.HOTA > rough.HOTA + 0.005
    assert both.id_switches < apart.id_switches
    assert both.MOTA > apart.MOTA - 0.005
