"""`degloss recon bench`: the command of the benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Flag = Annotated[bool, Parameter(negative=(), show_default=False)]


def bench(
    spec: str,
    /,
    *captures: Path,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    workers: int = 1,
    resume: Flag = False,
    limit: int | None = None,
    json: Flag = False,
) -> None:
    """Compare methods on captures with truth: every remover, repair, solver and integrator that the spec names, combined.

    Writes results.jsonl (a row for each measurement), summary.json, table.md and report.html. An interrupted run goes on with --resume.

    Parameters
    ----------
    spec
        A YAML file, or a shipped benchmark: paper, zoo, diligent, diligent-few.
    captures
        Captures, set folders or folders of captures, in place of the spec's own. The benchmarks diligent need the folder of DiLiGenT's
        objects.
    output
        The folder of the run.
    workers
        Processes that measure at the same time.
    resume
        Go on with a run that is there.
    limit
        At most so many captures, evenly spaced: a smaller benchmark for a first look.
    json
        Print the summary as one JSON object on stdout.
    """
    from gen.errors import InputError
    from gen.files import dumps, keep_apart, write_json, writing
    from gen.sets.set_spec import evenly
    from recon.benchmark.page import benchmark_page
    from recon.benchmark.run import begin, check_folder, maps_there, run_units
    from recon.benchmark.spec import Source, read_benchmark
    from recon.benchmark.summary import markdown, summarise
    from recon.benchmark.units import places, units
    from recon.page import write_report
    from recon.progress import steps

    wanted, folder = read_benchmark(spec)
    if not 1 <= workers <= 256:
        raise InputError(f"--workers {workers}: must be from 1 to 256")
    if limit is not None and limit < 1:
        raise InputError(f"--limit {limit}: must be at least 1")
    if captures:
        for path in captures:
            keep_apart(path, output)
        sources, folder = tuple(Source(path=str(path)) for path in captures), Path()
        wanted = wanted.model_copy(update={"captures": sources})
    if not wanted.captures:
        raise InputError(f"{spec}: names no captures; give their folder, as in: degloss recon bench {spec} FOLDER -o {output}")
    check_folder(output, wanted, resume)
    if any(source.path is None for source in wanted.captures):
        begin(output, wanted)  # what is rendered is kept; where nothing is, a slip in the paths leaves no folder behind
    combinations = wanted.combinations()
    try:
        with steps() as step:
            step("finding and rendering captures")
            where = places(wanted.captures, folder, output / "captures")
            every = units(wanted, [where[i] for i in evenly(len(where), limit)])
            begin(output, wanted)
            step.expect(len(every))
            rows = run_units(output, every, combinations, workers, lambda done, of: step(f"measuring, {done} of {of} done"))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; what is measured is kept in {output}: run the same command with --resume") from None
    summary = summarise(rows, combinations, wanted.seed)
    write_json(output / "summary.json", summary)
    text = markdown(wanted.benchmark, summary)
    with writing(output / "table.md") as temporary:
        temporary.write_text(text, encoding="utf-8")
    write_report(output, lambda: benchmark_page(wanted.benchmark, summary, maps_there(output, every)))
    print(dumps(summary) if json else f"{text}\n{output}")
