"""`rattlesweep classify`: other thresholds for stored runs."""

from __future__ import annotations

from pathlib import Path

from rattlesweep.cli.common import command, options, print_summary, say


@command("Sweeps", "rattlesweep classify out/quickstart --set classify.sw_departure=0.1")
@options.directory
@options.overrides
def classify(directory: Path, overrides: tuple[str, ...]) -> None:
    """Classify the stored runs of a directory again, without integrating.

    Rewrites the types in the blocks and the summary, and notes both the thresholds of the config
    and the new ones in the manifest. Prints one row per case on standard output.
    """
    from rattlesweep.sweeps.classify import classify_stored

    done = classify_stored(directory, overrides)
    print_summary(done.summary, directory)
    say(
        f"{done.changed} runs have changed their type; written: {done.files} files, "
        f"summary.parquet and manifest.json in {directory}"
    )
    before = "" if done.before == done.now else f"; before by {_words(done.before)}"
    say(f"types by {_words(done.now)}{before}")
    if done.now != done.own:
        say(
            f"`rattlesweep run` would put back those of the config ({_words(done.own)}): to keep "
            "these, set them there"
        )


def _words(thresholds: dict[str, float]) -> str:
    return ", ".join(f"{key} {value:g}" for key, value in thresholds.items())
