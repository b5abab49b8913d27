"""The commands, one module each: parse, call, print. Heavy imports stand inside the functions, for
a quick start.
"""
