"""Bus master and collector: SYNC out, one measurement per cycle in (not a CiA 309 gateway).

`nmt_master` proves, starts and restarts the nodes; `proven_blocks` makes the blocks of other nodes not valid;
`collector` combines the frames of a cycle; `loop` joins them, and `service` gives them buses and a clock.
"""
