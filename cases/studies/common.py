"""What the studies share: tables, figures, the command line; schemes of uniform quadrature.

A script of this folder has `main(small)`, which prints its tables in Markdown, writes them as CSV
files and its figure as PDF and PNG into the current folder, and returns the numbers that its text
promises. `python SCRIPT --small` is a short form of a few seconds, which the tests run.
"""

import argparse
import csv
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import qbxstokes as qs
from qbxstokes.bie.accuracy import plain_body
from qbxstokes.plots import style
from qbxstokes.qbx.operator import UniformScheme
from qbxstokes.simulation.hydrodynamics import true_error


class Table:
    """Rows of plain values: `table[name]` is a column, `where` the rows with given values."""

    def __init__(self, name, about, rows=()):
        """name: that of the CSV file; about: what the columns are and in which units."""
        self.name, self.about, self.rows = name, about, list(rows)

    def add(self, **row):
        """Append a row."""
        self.rows.append(row)

    def __getitem__(self, column):
        """A column as an array."""
        return np.array([row[column] for row in self.rows])

    def where(self, **values):
        """The rows with these values."""
        chosen = [row for row in self.rows if all(row[n] == v for n, v in values.items())]
        return Table(self.name, self.about, chosen)

    def write(self):
        """Write NAME.csv into the current folder; `about` is a comment in its first line."""
        with Path(f"{self.name}.csv").open("w", newline="", encoding="utf-8") as file:
            file.write(f"# {self.about}\n")
            writer = csv.DictWriter(file, list(self.rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)


def markdown(head, rows):
    """Print a table."""
    print(f"\n| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


@contextmanager
def figure(name, width, height, rows=1, columns=1, outside=None, **shared):
    """Panels in rows, one list, of a figure of this size in inches: NAME.pdf and NAME.png.

    outside: title of the legend that stands beside the panels, of what is named in the first one.
    """
    from PIL import Image

    with style.styled():
        drawn = style.new_figure(width, height)
        panels = drawn.subplots(rows, columns, squeeze=False, **shared).ravel().tolist()
        yield panels
        style.letter_panels(panels)
        if outside is not None:
            names = panels[0].get_legend_handles_labels()
            drawn.legend(*names, title=outside or None, loc="outside right center")
        style.save(drawn, Path(f"{name}.pdf"))
        path = style.save(drawn, Path(f"{name}.png"), 200.0)
    # With a palette, several times smaller; lines keep their edges.
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(64, dither=Image.Dither.NONE)
        small.save(path, "PNG", optimize=True, dpi=picture.info.get("dpi", (72, 72)))


def labelled(panel, x, y, log=""):
    """Name the axes of a panel; log: which of "x" and "y" are logarithmic."""
    panel.set_xlabel(x)
    panel.set_ylabel(y)
    for letter in log:
        getattr(panel, f"set_{letter}scale")("log")


def curves(panel, table, x, y, by, text="${:g}$"):
    """Draw a column over another, a curve with markers for each value of `by`, named by text."""
    for index, value in enumerate(dict.fromkeys(table[by].tolist())):
        rows = table.where(**{by: value})
        panel.plot(rows[x], rows[y], label=text.format(value), **style.line_style(index, True))


def command(main):
    """Of a script's `main`: run from the command line, it prints the numbers that it returns."""
    if main.__module__ == "__main__":
        about = main.__globals__["__doc__"].split("\n")[0]
        parser = argparse.ArgumentParser(description=about)
        parser.add_argument("--small", action="store_true", help="the short form, a few seconds")
        found = main(parser.parse_args().small)
        print("", *(f"{name}: {value:.3g}" for name, value in found.items()), sep="\n")
    return main


# -- quadrature -----------------------------------------------------------------------------------

PLACE = (0.3, 2.0, -0.5)


def every_term():
    """Shear with a paraboloid on top: every term of the laws up to second order counts at PLACE."""
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = hessian[0, 2, 2] = 0.5
    gradient = [[0.2, 1.0, 0.0], [0.0, -0.1, 0.3], [0.1, 0.0, -0.1]]
    return qs.flow("polynomial", gradient=gradient, hessian=hessian.tolist())


def power(value, decimals=1):
    """A number and a power of ten: 1.7e-4."""
    mantissa, _, exponent = f"{value:.{decimals}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def uniform(k, n_theta, order, r_over_h, upsampling):
    """The scheme of the thesis with n_phi = k n_theta, at least enough for the modes in use."""
    n_phi = max(8, 2 * round(0.5 * k * n_theta))
    return UniformScheme(n_theta, n_phi, order, r_over_h, upsampling)


def largest_ratio(k, n_theta):
    """The largest admissible r/h: k^2 n_theta/(2 pi), or n_theta/(2 pi k) for k > 1."""
    return min(k * k, 1.0 / k) * n_theta / (2.0 * np.pi)


def formed(k, scheme):
    """Model of a body by a scheme, its true error, and the wall time (s) of its set-up."""
    begin = time.perf_counter()
    model = plain_body(qs.Spheroid(k), scheme).model
    spent = time.perf_counter() - begin
    return model, true_error(model), spent
