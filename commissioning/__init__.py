"""Brings a skin up: who is on the bus, node-IDs, objects and programs of the boards, whether they keep the contract.

Each verb (`*_command`) leads talks with the boards of a bus: frames and times in, frames out, a turn by `talk`.
"""
