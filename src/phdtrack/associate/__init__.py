"""From states to identities, online and corrected offline: multi-frame graph matching, or the
filter's own labels.
"""
