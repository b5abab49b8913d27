"""The measured tables of docs/results/: one script per table, ours beside the paper's where there is one."""
