"""Identification of a balance's dynamics: from a shaken rig, from a free decay, from a published response table."""
