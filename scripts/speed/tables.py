"""Reads the tables that the benchmarks print."""


def number(text):
    try:
        return float(text) if "." in text or "e" in text or text in ("nan", "inf") else int(text)
    except ValueError:
        return text


def tables(text):
    """Every Markdown table of a text, as a list of rows, each a mapping from the header's names."""
    found, header = [], None
    for line in text.splitlines():
        if not line.startswith("|"):
            header = None
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if header is None:
            header = cells
            found.append([])
        elif not all(set(cell) <= {"-"} for cell in cells):
            found[-1].append(dict(zip(header, map(number, cells))))
    return found
