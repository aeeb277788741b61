"""The steps of scripts/setup.py: machine (what must be there), installed (what already is), wheels (fetch and unpack), parts (what goes where)."""
