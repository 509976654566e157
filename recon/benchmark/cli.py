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

    A spec of views compares the meshes of objects seen from several sides instead, each view's gloss removed before they are joined.

    Writes results.jsonl (a row for each measurement), summary.json, table.md and report.html. An interrupted run goes on with --resume;
    methods that were left out for a missing package are tried again.

    Parameters
    ----------
    spec
        A YAML file, or a shipped benchmark: paper, zoo, diligent, diligent-few, multiview.
    captures
        Captures, set folders or folders of captures, in place of the spec's own. The benchmarks diligent need the folder of DiLiGenT's
        objects. For a spec of views: folders of views, as degloss recon multiview takes them, or folders of such folders.
    output
        The folder of the run.
    workers
        Processes that render, and then measure, at the same time.
    resume
        Go on with a run that is there.
    limit
        At most so many captures, evenly spaced: a smaller benchmark for a first look. For a spec of views: so many objects.
    json
        Print the summary as one JSON object on stdout.
    """
    from gen.errors import InputError
    from gen.files import dumps, keep_apart, write_json, writing
    from recon.benchmark.run import begin, check_folder, run_tasks
    from recon.benchmark.spec import read_benchmark
    from recon.benchmark.work import work_of
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
        wanted, folder = wanted.of(captures), Path()
    if not wanted.sources:
        what = "captures" if wanted.views is None else "views"
        raise InputError(f"{spec}: names no {what}; give their folder, as in: degloss recon bench {spec} FOLDER -o {output}")
    check_folder(output, wanted, resume)
    if any(source.path is None for source in wanted.sources):
        begin(output, wanted)  # what is rendered is kept; where nothing is, a slip in the paths leaves no folder behind
    try:
        with steps() as step:
            step("finding and rendering captures")
            work = work_of(wanted, folder, output, workers, limit)
            begin(output, wanted)
            step.expect(len(work.tasks))
            rows = run_tasks(output, work.tasks, workers, lambda done, of: step(f"measuring, {done} of {of} done"))
        results = work.results(rows)
        write_json(output / "summary.json", results.summary)
        with writing(output / "table.md") as temporary:
            temporary.write_text(results.table, encoding="utf-8")
        write_report(output, results.page)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; what is measured is kept in {output}: run the same command with --resume") from None
    print(dumps(results.summary) if json else f"{results.table}\n{output}")
