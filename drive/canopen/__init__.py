"""The CANopen face of a drive (CiA 301): frames in, frames out, time as an argument."""
