"""Speed and memory, measured in one run: `make bench` (quick) and `make bench-full`."""
