"""Published simulation studies, repeated.

Comes in: settings of a study.
Goes out: a Parquet file a job, and tables beside the published ones.
Start reading: `canal/study.py`, `hostetter_royle/study.py`; `jobs.py` spreads and resumes both.
The pages: docs/classical.md, docs/measured.md. Our own studies are scripts in `simulations/`.
"""

__all__: list[str] = []
