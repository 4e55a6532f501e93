"""Recordings as polars tables: run it as it is, or cell by cell in a notebook.

cd samples && python tables.py
"""

# %% A recording is a lazy table. Nothing is read yet; a folder or "logs/*.mcap" would do as well.
import tempfile
from pathlib import Path

import polars as pl

import fte_sniff

recording = Path(__file__).with_name("damaged.mcap")
rows = fte_sniff.scan(recording)
print(rows.collect_schema())

# %% How far each motor's speed strayed. Only the columns and rows that this needs are decoded.
speeds = (
    rows.filter(pl.col("kind") == "speed_feedback", pl.col("status") == "ok")
    .group_by("motor")
    .agg(
        pl.len().alias("frames"),
        pl.col("rpm").min().alias("low"),
        pl.col("rpm").max().alias("high"),
    )
    .sort("motor")
)
print(speeds.collect(engine="streaming"))

# %% What went wrong on the wire, and how often.
print(
    rows.select(pl.col("faults").explode())
    .drop_nulls()
    .group_by("faults")
    .len()
    .sort("len")
    .collect()
)

# %% The gap before each frame of motor 1, in milliseconds.
gaps = rows.filter(pl.col("motor") == 1).select(
    (pl.col("time").diff().dt.total_nanoseconds() / 1e6).alias("ms")
)
print(gaps.collect().describe())

# %% As a file for other tools; a recording of any size goes through in bounded memory.
with tempfile.TemporaryDirectory() as folder:
    table = Path(folder, "damaged.parquet")
    rows.sink_parquet(table)
    print(pl.read_parquet(table).height, "rows in", table.name)
