"""All parts, in the order in which they run."""

from __future__ import annotations

from benchmarks import (
    c_kernel,
    command,
    d14,
    memory,
    mht,
    numpy_twins,
    others,
    particle_phd,
    roofline,
    scene,
    stone_soup,
    whole_tracker,
)
from benchmarks.parts import Part

PARTS: tuple[Part, ...] = (
    Part("particle-phd", "Particle PHD filter, ms per frame", particle_phd.run, particle_phd.KEYS),
    Part(
        "numpy-twins",
        "Twins in NumPy, worst case of births",
        numpy_twins.run,
        numpy_twins.KEYS,
        True,
    ),
    Part("c-kernel", "Likelihood kernel against C", c_kernel.run, c_kernel.KEYS, True),
    Part("roofline", "What the machine allows", roofline.run, roofline.KEYS),
    Part("memory", "Memory", memory.run, memory.KEYS),
    Part("gm-phd", "GM-PHD filter, µs per step", others.gm_phd, ("gm_phd_us", "gm_phd")),
    Part("pmb", "PMB filter, µs per step", others.pmb, ("pmb_us", "pmb")),
    Part("mht", "Multiple hypotheses, ms per frame", mht.run, mht.KEYS),
    Part("scene", "Learned scene against uniform densities, per frame", scene.run, scene.KEYS),
    Part("d14", "D14's sequence, s", d14.run, d14.KEYS),
    Part("extraction", "Extraction, ms per frame", others.extraction, ("extraction",)),
    Part("stone-soup", "Stone Soup", stone_soup.run, stone_soup.KEYS),
    Part("association", "Association", others.association, ("association",)),
    Part(
        "tracker",
        "Whole tracker, detections in, tracks out",
        whole_tracker.run,
        whole_tracker.KEYS,
        True,
    ),
    Part("detectors", "Detectors, ms per frame", others.detectors, ("detectors",)),
    Part("first-use", "First use and start", others.first_use, ("first_use",)),
    Part("process", "phdtrack track, whole process", others.process, ("process",)),
    Part(
        "command",
        "phdtrack track beside MOG2 + SORT + VideoWriter",
        command.run,
        ("command",),
        True,
    ),
)
