"""Hostile workbooks: every reader limits the memory and the time for the cells."""

import sys
import zipfile

import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log
from fluxobs.logs.formats.excel import read_sheets
from fluxobs.logs.formats.isolated import read_apart
from support.biff import old_workbook
from support.hostile import refused, with_zeros
from support.records import SMALL_LOG as COLUMNS

T = COLUMNS["t"]


def workbook(path, far=None, blank=False):
    xlsxwriter = pytest.importorskip("xlsxwriter")
    pytest.importorskip("fastexcel")
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet()
        for n, (name, values) in enumerate(COLUMNS.items()):
            sheet.write(0, n, name)
            sheet.write_column(1, n, values)
        if far and blank:
            sheet.write_blank(*far, None, book.add_format({"bold": True}))
        elif far:
            sheet.write(*far, 1.0)
    return path


def test_a_cell_far_from_the_table(tmp_path):
    refused(workbook(tmp_path / "log.xlsx", (99_999, 9_999)), "1000000000 cells up to the last")


def test_a_blank_cell_far_from_the_table_is_left_alone(tmp_path):
    path = workbook(tmp_path / "log.xlsx", (99_999, 9_999), blank=True)
    assert len(read_log(path)) == len(T)


def edit(path, change_sheet, change_texts=bytes):
    """Change the first sheet of a workbook, and move this sheet to an unusual place in the file.

    `change_texts` may change the shared texts of the workbook.
    """
    with zipfile.ZipFile(path) as book:
        parts = {name: book.read(name) for name in book.namelist()}
    sheet = change_sheet(parts.pop("xl/worksheets/sheet1.xml"))
    links = parts["xl/_rels/workbook.xml.rels"]
    parts["xl/sharedStrings.xml"] = change_texts(parts["xl/sharedStrings.xml"])
    parts["xl/_rels/workbook.xml.rels"] = links.replace(b"worksheets/sheet1.xml", b"image.png")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for name, content in {**parts, "xl/image.png": sheet}.items():
            book.writestr(name, content)


def test_far_cells_without_references(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    wide = b"<row>" + b"<c><v>1</v></c>" * 20_000 + b"</row>"
    long = b"<row><c><v>1</v></c></row>" * 2_000
    edit(path, lambda sheet: sheet.replace(b"</sheetData>", wide + long + b"</sheetData>"))
    refused(path, "cells up to the last")


def test_a_workbook_that_is_large_when_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("fluxobs.logs.formats.workbook.BYTES", 1 << 20)
    path = workbook(tmp_path / "log.xlsx")
    value = b'<row><c t="str"><v>' + b"1" * (1 << 20) + b"</v></c></row></sheetData>"
    edit(path, lambda sheet: sheet.replace(b"</sheetData>", value))
    refused(path, "bytes, more than 1048576")


limited = pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits memory")


@limited
def test_a_long_text_that_many_cells_share(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    cells = b"<row>" + b'<c t="s"><v>0</v></c>' * 5 + b"</row>"
    edit(
        path,
        lambda sheet: sheet.replace(b"</sheetData>", cells * 1000 + b"</sheetData>"),
        lambda texts: texts.replace(b">t<", b">" + b"t" * 1_000_000 + b"<"),
    )
    assert path.stat().st_size < 30_000
    refused(path, "reading the file ended with .* more than 10.. MB of memory")


@limited
def test_cells_far_apart_in_an_old_workbook(tmp_path):
    pytest.importorskip("fastexcel")
    content = old_workbook(40, [(0, 0, 1.0), (65535, 255, 1.0)])
    (tmp_path / "log.xls").write_bytes(content)
    assert len(content) < 6_000
    refused(tmp_path / "log.xls", "reading the file ended with .* more than 1024 MB of memory")


def test_a_workbook_that_takes_too_long(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    with pytest.raises(FluxobsError, match=r"log\.xlsx: reading the file took more than 0.01 s"):
        read_apart(read_sheets, path, None, 1 << 30, 0.01)


def test_entities_in_a_workbook(tmp_path):
    path = workbook(tmp_path / "log.xlsx")
    head = b'?><!DOCTYPE x [<!ENTITY a "1">]>'
    edit(path, lambda sheet: sheet.replace(b"?>", head, 1))
    refused(path, "not a readable workbook: a sheet must not have a document type")


@pytest.mark.parametrize("cells", [(1 << 40, 1), (1, 1 << 40)])
def test_repeated_cells_of_an_open_document(tmp_path, cells):
    pytest.importorskip("fastexcel")
    rows, columns = cells
    with zipfile.ZipFile(tmp_path / "log.ods", "w") as book:
        book.writestr(
            "content.xml",
            f'<x><table:table><table:table-row table:number-rows-repeated="{rows}">'
            f'<table:table-cell office:value="1" table:number-columns-repeated="{columns}"/>'
            f"</table:table-row></table:table></x>",
        )
    refused(tmp_path / "log.ods", "1099511627776 cells up to the last")


def test_a_workbook_that_unpacks_to_far_more_than_its_size(tmp_path):
    path = with_zeros(workbook(tmp_path / "log.xlsx"), "xl/worksheets/sheet2.xml", 8 * 35)
    refused(path, "the workbook has 2936.* bytes, more than 268435456")
