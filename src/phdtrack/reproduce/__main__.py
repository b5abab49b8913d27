"""All measured tables: `make experiments`. Each can be run alone; see the modules."""

from __future__ import annotations

from phdtrack.reproduce import count, detections, e13, groups, occlusion, particles, plane, standard, videos


def main() -> None:
    """Every experiment, the short ones first."""
    count.main()
    standard.main()
    groups.main()
    plane.main()
    e13.main()
    occlusion.main()
    videos.main()
    detections.main()
    particles.main()


if __name__ == "__main__":
    main()
