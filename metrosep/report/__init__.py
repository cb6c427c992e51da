"""Reports, comparisons and the index of a batch, made from result documents only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.report.aqdef import render_dfq as render_dfq, write_dfq as write_dfq
    from metrosep.report.compare import (
        compare_documents as compare_documents,
        compare_recipes as compare_recipes,
    )
    from metrosep.report.comparison import (
        Comparison as Comparison,
        Row as Row,
        compare_tables as compare_tables,
    )
    from metrosep.report.csv_long import render_csv as render_csv, write_csv as write_csv
    from metrosep.report.html import render_html as render_html, write_html as write_html
    from metrosep.report.index import render_index as render_index, write_index as write_index
    from metrosep.report.parquet import (
        render_index_parquet as render_index_parquet,
        render_parquet as render_parquet,
        write_index_parquet as write_index_parquet,
        write_parquet as write_parquet,
    )
    from metrosep.report.qif import render_qif as render_qif, write_qif as write_qif
    from metrosep.report.typeset import (
        render_pdf as render_pdf,
        write_pdf as write_pdf,
        write_plain_pdf as write_plain_pdf,
    )
    from metrosep.report.workbook import (
        write_index_workbook as write_index_workbook,
        write_workbook as write_workbook,
    )

__getattr__, __dir__ = lazy_package(__name__)
