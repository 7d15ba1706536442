"""Drives on EtherCAT: the slave controller, the segment, the services, a master in memory."""
