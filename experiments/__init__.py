"""The measured tables of docs/results/: one script per table, next to the paper's figures where
there are any.
"""
