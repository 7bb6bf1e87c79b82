"""Figures for any paper: own texts, panels, sizes, colours that mean one value."""

from __future__ import annotations

import itertools
import locale
import re
import shutil
from pathlib import Path
from subprocess import run
from typing import Any

import matplotlib as mpl
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text
from refusal import assert_refused
from sweeping import ROOT, invoke, sweep

import rattlesweep as rs
from rattlesweep.analysis import room, style
from rattlesweep.analysis.style import LEAST_SIZE, SERIES

SPINS = [0.1, 0.2, 0.3, 0.4, 0.5]
PUSHES = [0.01, 0.1]
SLOW = pytest.mark.slow
MM = 1 / 25.4
SIGMAS = {"sigma": [0, 0.001]}


def config(sign: int) -> dict[str, Any]:
    """Return a sweep of the closed form in one direction of spin."""
    target = {"K_p": [0.1, 0.3, 1.0]} if sign > 0 else {"K_r": [0.02, 0.05, 0.1]}
    return {
        "name": "mine",
        "model": "gh",
        "bodies": {"source": "sd", "samples": 4, "target": target | {"rel_tol": 0.1}},
        "spin": {"n_i": [sign * spin for spin in SPINS], "omega_xy0": PUSHES},
    }


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("figures")
    sweep(root / "up", config(1))
    sweep(root / "down", config(-1))
    return root


def titles(figure: Any) -> list[str]:
    return [axes.get_title() for axes in figure.axes]


def entries(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def caption(figure: Any) -> str:
    return figure.get_supxlabel().replace("\n", " ")


def colours(figure: Any) -> dict[str, str]:
    """Return the colours of the entries of a legend."""
    handles = figure.legends[0].legend_handles
    return {
        text: to_hex(handle.get_color()).upper()
        for text, handle in zip(entries(figure), handles, strict=True)
        if text != "theory"
    }


def test_panels_are_those_that_are_wished(out):
    figure = rs.load(out / "up").plot("times", panels="n_i")
    assert titles(figure) == [f"$n_{{i}}$ = {spin}" for spin in SPINS]
    # 2 x 3 places, as in the paper; the sixth is empty.
    grid = figure.axes[0].get_gridspec()
    assert (grid.nrows, grid.ncols) == (2, 3)
    assert len(colours(figure)) == 2
    figure = rs.load(out / "up").plot("fractions", panels="K_p")
    assert len({*titles(figure)} - {""}) == 3
    figure = rs.load(out / "up").plot("fractions", x="xi", panels="omega_xy0")
    assert [text for text in titles(figure) if "omega" in text] == titles(figure)[:2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--panels", "n_ii"), 'panels n_ii: "n_ii" is not one of K_p, n_i'),
        (("--panels", "n_i", "--x", "n_i"), "panels n_i: it is x, too"),
        (("--panels", "n_i", "--kind", "scatter"), "leave panels out"),
    ],
)
def test_wrong_panels_are_refused(arguments, message, out):
    assert_refused(invoke("plot", out / "up", *arguments), 2, message)


def test_any_text_can_be_replaced_by_a_file(out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "german.yaml").write_text(
        "ylabel: Umkehrzeit\n"
        "K_p: $\\kappa$\n"
        "omega_xy0: Stoß\n"
        "theory: Theorie\n"
        "Steady spins: Stetige Drehung\n"
        "caption: Mittelwerte von 4 Körpern.\n"
        "SS: stetig\n"  # occurs in other figures of the sweep
    )
    command = ("plot", out / "up", "--kind", "times", "--title", "Steady spins")
    written = invoke(*command, "--labels", "german.yaml", "--output", "own.svg")
    assert written.exit_code == 0
    figure = rs.load(out / "up").plot(
        "times", labels="german.yaml", title="Steady spins", panels="n_i"
    )
    assert {axes.get_ylabel() for axes in figure.axes} == {"", "Umkehrzeit"}
    assert {axes.get_xlabel() for axes in figure.axes} == {"", "$\\kappa$"}
    assert entries(figure) == ["Stoß = 0.01", "Stoß = 0.1", "Theorie"]
    shown = [text.get_text() for text in figure.findobj(Text)]
    assert "Stetige Drehung" in shown
    assert "Mittelwerte von 4 Körpern." in shown
    assert not any("Mean of" in text for text in shown)


def test_a_replaced_symbol_keeps_its_unit_and_types_have_their_names(out):
    labels = {"n_i": "Spin", "R": "kehrt um", "xlabel": "x", "K_r": "k"}
    figure = rs.load(out / "down").plot("fractions", labels=labels)
    assert all(title in ("", *titles(figure)[:5]) for title in titles(figure))
    assert titles(figure)[0] == "Spin = −0.5"
    assert "kehrt um" in entries(figure)
    assert {axes.get_xlabel() for axes in figure.axes} == {"", "x"}
    figure = rs.load(out / "up").plot("ratio", labels={"n_i": "Spin"})
    assert figure.axes[0].get_xlabel() == r"Spin ($\sqrt{g/a}$)"


def test_a_file_of_texts_serves_all_figures_of_a_sweep(out):
    labels = {
        "theory": "Theorie",
        "Bondi's threshold": "Schwelle",
        "stable by Bondi's threshold": "stabil nach Bondi",
    }
    for kind in ("times", "ratio", "fractions", "distribution"):
        rs.load(out / "down").plot(kind, labels=labels)


def test_legends_of_fractions_end_with_theory(out):
    friction = rs.load(out / "up").plot("times")
    assert "friction" not in caption(friction)
    assert entries(rs.load(out / "down").plot("fractions")) == [
        "R: reverses",
        "stable by Bondi's threshold",
    ]


def test_the_caption_says_that_theory_has_no_friction(tmp_path):
    sweep(tmp_path / "lossy", config(1) | {"model": "reduced", "dissipation": SIGMAS})
    lossy = rs.load(tmp_path / "lossy").plot("times", panels="sigma")
    assert "mean over all runs, without friction." in caption(lossy)


def words_of(path: Path) -> str:
    """Return the text of an SVG that has its letters."""
    return re.sub("<[^>]*>", " ", path.read_text().split("</metadata>")[1])


@pytest.fixture
def german(tmp_path, monkeypatch) -> None:
    """Make the user's locale a German one, which systems seldom have."""
    if shutil.which("localedef") is None:
        pytest.skip("localedef is needed, of glibc")
    made = tmp_path / "de_DE.UTF-8"
    # It returns 1 where it has warned.
    run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(made)], capture_output=True)
    if not made.exists():
        pytest.skip("the system has no definition of the locale")
    monkeypatch.setenv("LOCPATH", str(tmp_path))
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")


def test_a_style_asks_for_the_decimal_comma_of_the_user(
    out, tmp_path, monkeypatch, german
):
    style = tmp_path / "own.mplstyle"
    style.write_text("axes.formatter.use_locale: True\nsvg.fonttype: none\n")
    command = ("plot", out / "up", "--kind", "times", "--output", tmp_path / "own.svg")
    assert invoke(*command, "--style", style).exit_code == 0
    drawn = words_of(tmp_path / "own.svg")
    assert "0,5" in drawn
    assert not re.search(r"\d\.\d", drawn)
    # Nothing else of the process has changed.
    assert locale.localeconv()["decimal_point"] == "."
    assert invoke(*command).exit_code == 0
    assert "0,5" not in words_of(tmp_path / "own.svg")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("xyzzy: x\n", "or a text of the figure: "),
        ("theorie: x\n", 'is no text of this figure; did you mean "theory"?'),
        ("yliable: x\n", 'did you mean "ylabel"?'),
        ("ylabel: 3\n", "a text is needed; write it in quotes"),
        ("ylabel: x\nylabel: y\n", "labels.yaml:2"),
        ("- ylabel\n", "labels.yaml:1"),
    ],
)
def test_wrong_labels_are_refused(text, message, out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "labels.yaml").write_text(text)
    command = ("plot", out / "up", "--kind", "times", "--labels", "labels.yaml")
    assert_refused(invoke(*command, "--output", "own.svg"), 2, message)
    assert not (tmp_path / "own.svg").exists()


def test_labels_on_axes_of_the_caller(out):
    own = mpl.figure.Figure()
    axes = own.subplots()
    sweep_of = rs.load(out / "up")
    select = {"K_p": 0.1}
    sweep_of.plot("times", select=select, ax=axes, labels={"ylabel": "Zeit"})
    assert axes.get_ylabel() == "Zeit"
    axes.set_ylabel("t")
    assert axes.get_ylabel() == "t"


def test_a_label_of_an_axis_is_its_own(out):
    """The caller's label takes the place of ours, and does not stand beside it."""
    figure = rs.load(out / "up").plot("ratio")
    ours = figure.axes[0].get_ylabel()
    assert ours
    figure.axes[0].set_ylabel("mine")
    shown = [text.get_text() for text in figure.findobj(Text)]
    assert ours not in shown


def test_a_value_has_one_colour_in_all_figures_of_a_sweep(out):
    for sign, name, target in ((1, "up", "K_p"), (-1, "down", "K_r")):
        stored = rs.load(out / name)
        spins = [sign * spin for spin in SPINS]
        whole = colours(stored.plot("times", x=target, panels="omega_xy0"))
        assert list(whole.values()) != []
        # The smallest spin is blue in both directions.
        wanted = {
            f"$n_{{i}}$ = {str(spin).replace('-', '−')}": colour.upper()
            for spin, (colour, _) in zip(spins, SERIES, strict=False)
        }
        assert whole == wanted
        some = [spins[1], spins[4]]
        part = colours(
            stored.plot("times", x=target, panels="omega_xy0", select={"n_i": some})
        )
        assert len(part) == 2
        assert part.items() <= whole.items()


def test_a_style_has_its_size_and_its_numbers(out):
    style = {"figure.figsize": (5.0, 4.0), "axes.unicode_minus": False}
    figure = rs.load(out / "down").plot("fractions", style=style)
    assert tuple(figure.get_size_inches()) == (5.0, 4.0)
    assert titles(figure)[0] == "$n_{i}$ = -0.5"
    figure = rs.load(out / "down").plot("fractions", style=style, size=(6, 3))
    assert tuple(figure.get_size_inches()) == (6.0, 3.0)


@pytest.mark.parametrize(
    "width", [85, pytest.param(125, marks=SLOW), pytest.param(180, marks=SLOW)]
)
@pytest.mark.parametrize("kind", ["fractions", "times", "distribution"])
def test_nothing_is_cut_or_below_six_points(kind, width, out):
    size = (width * MM, 0.75 * width * MM)
    figure = rs.load(out / "down").plot(kind, size=size)
    assert tuple(figure.get_size_inches()) == pytest.approx(size)
    frame = figure.bbox.padded(1.0)
    figure.draw_without_rendering()
    for text in figure.findobj(Text):
        if text.get_text() and text.get_visible():
            assert text.get_fontsize() >= LEAST_SIZE - 1e-9, text
    shown = [axes.get_tightbbox() for axes in figure.axes]
    shown += [figure.legends[0].get_window_extent()] if figure.legends else []
    for box in shown:
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
        assert frame.y0 <= box.y0 < box.y1 <= frame.y1


def test_numbers_of_narrow_panels_stand_apart(out):
    figure = rs.load(out / "down").plot("fractions", x="xi", size=(85 * MM, 70 * MM))
    figure.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for axes in figure.axes
        for text in axes.get_xticklabels()
        if text.get_text()
        and text.get_visible()
        and axes.get_xlim()[0] <= text.get_position()[0] <= axes.get_xlim()[1]
    ]
    shown = [box for box in boxes if box.width]
    assert len(shown) > 4
    for box, other in itertools.combinations(shown, 2):
        assert not box.overlaps(other)


@pytest.mark.parametrize("width", [85, 125, 180])
def test_headings_of_narrow_panels_neither_touch_nor_leave_the_figure(width):
    """A letter, a launch and a long legend, as in figures of the paper."""
    size = (width * MM, 3.0)
    with style.styled(), room.sized(size):
        figure = style.new_figure(*size)
        for letter, axes in zip("ab", figure.subplots(1, 2), strict=True):
            axes.plot([0, 1], [0, 1])
            axes.set_title(f"({letter}-1)", loc="left")
            axes.set_title(r"GH, $n_i$ = -0.1, $\omega_{xy0}$ = 0.01")
        ways = ("in both", "in the unsteady direction only", "in neither")
        style.add_legend(figure, [style.entry(way, marker="o") for way in ways])
        room.fit_texts(figure)
    room.check_panels(figure, size)
    assert room.misplaced_texts(figure) == []
    for axes in figure.axes:
        said = axes.get_title(loc="left") + axes.get_title()
        assert "-1)" in said
        assert "0.01" in said
        assert axes.title.get_window_extent().width <= axes.bbox.width + 1
        assert axes.title.get_fontsize() >= LEAST_SIZE


def test_a_figure_whose_headings_touch_is_refused():
    size = (85 * MM, 3.0)
    with style.styled():
        figure = style.new_figure(*size)
        for axes in figure.subplots(1, 3):
            axes.set_title("a heading without any comma")
    with pytest.raises(rs.ConfigError, match="give more width"):
        room.check_panels(figure, size)


def test_a_size_without_room_is_refused(out):
    command = ("plot", out / "down", "--kind", "fractions", "--size")
    assert_refused(invoke(*command, "1.5,1"), 2, "do not fit into 1.5 x 1 inches")
    refused = invoke(*command, "3.35,1.2")
    # It names a height that does.
    enough = re.search(r"give (3\.35,[\d.]+), select", refused.stderr)[1]
    assert invoke(*command, enough).exit_code == 0


def test_a_map_has_no_panel_of_one_colour(tmp_path):
    """All runs of the closed form reverse, so that a panel of types says nothing."""
    values = {"linspace": [0.6, 0.9, 9]}
    grid = {"source": "grid", "base": {"preset": "GH"}, "axes": {"theta": values}}
    spin = {"n_i": {"linspace": [0.1, 0.5, 9]}, "omega_xy0": 0.01}
    sweep(tmp_path / "map", {"model": "gh", "bodies": grid, "spin": spin})
    stored = rs.load(tmp_path / "map")
    figure = stored.plot("map")
    assert titles(figure) == ["$t_r/t_{rGH}$", ""]  # a panel and the bar of colours
    caption = figure._supxlabel.get_text().replace("\n", " ")
    assert "All cells are of one type, R: reverses." in caption


@pytest.mark.slow
def test_the_lines_of_the_page(out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "unsteady").symlink_to(out / "up")
    text = (ROOT / "docs" / "figures.md").read_text()
    (labels,) = [part.split("```")[0] for part in text.split("```yaml\n")[1:]]
    (tmp_path / "german.yaml").write_text(labels)
    for block in text.split("```sh\n")[1:]:
        assert invoke(*block.split("```")[0].split()[1:]).exit_code == 0
    assert {path.name for path in tmp_path.glob("*.pdf")} == {"times.pdf", "german.pdf"}
