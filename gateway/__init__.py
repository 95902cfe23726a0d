"""Bus master and collector: SYNC out, one measurement per cycle in (not a CiA 309 gateway)."""
