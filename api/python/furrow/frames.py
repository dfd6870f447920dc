"""CSV and Parquet as data frames whose columns have the same types whatever is in them.

Labels and other texts are pandas' ``string``, counts ``int64`` (``Int64`` where some are missing), all else ``float64``.
Numbers are read to the last bit.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Callable, Collection

import numpy as np
import numpy.typing as npt
import pandas as pd

TEXTS_OF_RUNS = frozenset({"key", "state", "outcome", "digest"})
COUNTS_OF_RUNS = frozenset({"job", "seed", "attempts"})
TEXTS_OF_COMPARISONS = frozenset({"metric", "interval", "test"})
NUMBERS_OF_COMPARISONS = frozenset(
    {"a", "b", "difference", "p", "p_holm", "odds_ratio", "d_z", "rank_biserial"}
    | {f"{interval}_{end}" for interval in ("ci95", "bootstrap_ci95", "odds_ratio_ci95") for end in ("low", "high")}
)
TEXTS_OF_PUBLICATIONS = frozenset({"verdict", "note"})
FIRST_NUMBER_OF_PUBLICATIONS = "published"


Column = pd.api.extensions.ExtensionArray | npt.NDArray[np.generic]


def of_table(csv: str, factors: Collection[str]) -> pd.DataFrame:
    """A table of results."""
    return _typed(_cells(csv), factors, _is_count)


def of_runs(csv: str, factors: Collection[str]) -> pd.DataFrame:
    """All runs of a sweep, a row each."""
    return _typed(_cells(csv), _texts_of_runs(factors), COUNTS_OF_RUNS.__contains__)


def of_runs_in_parquet(content: bytes, factors: Collection[str]) -> pd.DataFrame:
    """The same from Parquet, which pyarrow reads."""
    runs = pd.read_parquet(io.BytesIO(content), engine="pyarrow")
    texts = _texts_of_runs(factors)
    kinds = {name: _kind(name, texts) for name in runs.columns}
    return runs.astype(kinds)


def of_comparison(csv: str, group_by: Collection[str]) -> pd.DataFrame:
    """A comparison; the first row has no labels: it is over all pairs."""
    texts = TEXTS_OF_COMPARISONS.union(group_by)
    return _typed(_cells(csv), texts, lambda name: name not in NUMBERS_OF_COMPARISONS)


def of_publication(csv: str) -> pd.DataFrame:
    """A published table beside results."""
    cells = _cells(csv)
    labels = cells.columns[: cells.columns.get_loc(FIRST_NUMBER_OF_PUBLICATIONS)]
    return _typed(cells, TEXTS_OF_PUBLICATIONS.union(labels), _is_count)


def has_parquet() -> bool:
    """Whether pyarrow is there."""
    return importlib.util.find_spec("pyarrow") is not None


def _texts_of_runs(factors: Collection[str]) -> frozenset[str]:
    """A factor that is called like another column goes by ``factor.`` before its name."""
    own = TEXTS_OF_RUNS | COUNTS_OF_RUNS
    return TEXTS_OF_RUNS.union(f"factor.{name}" if name in own else name for name in factors)


def _cells(csv: str) -> pd.DataFrame:
    return pd.read_csv(io.StringIO(csv), dtype=str, keep_default_na=False)


def _typed(cells: pd.DataFrame, texts: Collection[str], is_count: Callable[[str], bool]) -> pd.DataFrame:
    columns: dict[str, Column] = {}
    for name in cells.columns:
        words = cells[name].tolist()
        if name in texts:
            columns[name] = pd.array([word or pd.NA for word in words], dtype="string")
        elif is_count(name):
            columns[name] = _counts(words)
        else:
            columns[name] = np.array([float(word) if word else np.nan for word in words], dtype=np.float64)
    return pd.DataFrame(columns, index=cells.index)


def _counts(words: list[str]) -> Column:
    if all(words):
        return np.array([int(word) for word in words], dtype=np.int64)
    return pd.array([int(word) if word else pd.NA for word in words], dtype="Int64")


def _is_count(name: str) -> bool:
    """Whether a column of a table counts runs; a label may stand before its name."""
    tail = name.rpartition(".")[2]
    return tail in ("n", "missing") or tail.endswith("_n")


def _kind(name: str, texts: Collection[str]) -> str:
    return "string" if name in texts else "int64" if name in COUNTS_OF_RUNS else "float64"
