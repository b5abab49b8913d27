"""The web server of the labelling page and the live page."""
