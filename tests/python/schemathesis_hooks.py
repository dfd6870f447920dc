"""How schemathesis reads answers that are no JSON: a Parquet file is one only if pyarrow reads it."""

import io
from typing import Any

import pyarrow.parquet
import schemathesis


@schemathesis.deserializer("application/vnd.apache.parquet")
def parquet(context: Any, response: Any) -> str:
    """The answer as the text that the description calls it."""
    pyarrow.parquet.read_table(io.BytesIO(response.content))
    return response.content.decode("latin-1")
