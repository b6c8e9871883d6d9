"""A little SVG: axes, cells, lines, points and words, for the charts of the examples."""

from html import escape
from math import log

INK, FAINT, FONT = "#222222", "#bbbbbb", "font-family='Helvetica, Arial, sans-serif'"


class Chart:
    """A page of some panels [px]."""

    def __init__(self, width, height):
        self.size = width, height
        self.parts = []

    def text(self, x, y, words, size=13, anchor="start", colour=INK, turn=0, weight="normal"):
        around = f" transform='rotate({turn} {x:.1f} {y:.1f})'" if turn else ""
        self.parts.append(f"<text x='{x:.1f}' y='{y:.1f}' font-size='{size}' text-anchor='{anchor}' fill='{colour}' "
                          f"font-weight='{weight}'{around}>{escape(words)}</text>")

    def line(self, points, colour=INK, width=1.0, dash=""):
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        self.parts.append(f"<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='{width}' "
                          f"stroke-dasharray='{dash}' stroke-linejoin='round'/>")

    def box(self, x, y, width, height, colour):
        self.parts.append(f"<rect x='{x:.1f}' y='{y:.1f}' width='{width:.1f}' height='{height:.1f}' fill='{colour}' "
                          "shape-rendering='crispEdges'/>")

    def dot(self, x, y, colour, radius=3.0):
        self.parts.append(f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{radius}' fill='{colour}'/>")

    def write(self, path):
        width, height = self.size
        body = "\n".join(self.parts)
        with open(path, "w") as file:
            file.write(f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' "
                       f"height='{height}' {FONT}>\n<rect width='100%' height='100%' fill='white'/>\n{body}\n</svg>\n")


class Panel:
    """Axes on a chart: `x` and `y` are (from, to, is it logarithmic), in data."""

    def __init__(self, chart, place, x, y, x_ticks, y_ticks, x_title, y_title, title):
        self.chart, self.place, self.x, self.y = chart, place, x, y
        self.ticks = x_ticks, y_ticks
        self.titles = x_title, y_title, title

    def at(self, x, y):
        """Data to the page."""
        left, top, width, height = self.place
        part = [(log(v / a) / log(b / a)) if logarithmic else (v - a) / (b - a)
                for v, (a, b, logarithmic) in ((x, self.x), (y, self.y))]
        return left + part[0] * width, top + (1 - part[1]) * height

    def axes(self):
        """Drawn last, over cells."""
        chart, (left, top, width, height) = self.chart, self.place
        chart.line([(left, top), (left, top + height), (left + width, top + height)])
        for value in self.ticks[0]:
            x, _ = self.at(value, self.y[0])
            chart.line([(x, top + height), (x, top + height + 4)])
            chart.text(x, top + height + 19, f"{value:g}", 12, "middle")
        for value in self.ticks[1]:
            _, y = self.at(self.x[0], value)
            chart.line([(left - 4, y), (left, y)])
            chart.text(left - 8, y + 4, f"{value:g}", 12, "end")
        chart.text(left + width / 2, top + height + 40, self.titles[0], 13, "middle")
        chart.text(left - 46, top + height / 2, self.titles[1], 13, "middle", turn=-90)
        chart.text(left, top - 14, self.titles[2], 14, weight="bold")

    def line(self, points, colour=INK, width=1.5, dash=""):
        self.chart.line([self.at(*point) for point in points], colour, width, dash)

    def cell(self, x, y, colour):
        """Of ranges x and y, cut to the axes."""
        (x0, x1), (y0, y1) = ((max(v[0], axis[0]), min(v[1], axis[1])) for v, axis in ((x, self.x), (y, self.y)))
        (left, low), (right, high) = self.at(x0, y0), self.at(x1, y1)
        self.chart.box(left, high, right - left + 0.7, low - high + 0.7, colour)

    def text(self, x, y, words, size=12, anchor="start", colour=INK, dx=0, dy=0):
        place = self.at(x, y)
        self.chart.text(place[0] + dx, place[1] + dy, words, size, anchor, colour)
