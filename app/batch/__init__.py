"""Pairs listed in a file, registered by many workers, with results as Parquet.

The driver reads the manifest, leaves out what is finished and cuts the rest into shards; workers
register a shard and write its results themselves. Which engine runs the workers changes nothing
else: Ray Data where it is installed, or processes of this machine.
"""
