"""The report of a campaign."""

import json
from pathlib import Path

from findings import Findings
from schedule import Schedule

FORMAT_PREFIX = "format "


def write(
    out: Path, schedule: Schedule, findings: Findings, facts: dict[str, object]
) -> None:
    """Writes `report.json` and `report.md`."""
    attacks = [progress.record() for progress in schedule.progress]
    kinds = [
        {"attack": attack, "kind": kind, "signature": signature, "times": times}
        for (attack, kind, signature), times in findings.counts.most_common()
    ]
    record = {
        **facts,
        "attacks": attacks,
        "kinds": kinds,
        "findings": findings.records,
        "broken": schedule.broken,
    }
    (out / "report.json").write_text(json.dumps(record, indent=2) + "\n")
    (out / "report.md").write_text(text(record), errors="backslashreplace")


def text(record: dict[str, object]) -> str:
    """The report to read."""
    lines = [
        "# Campaign", "",
        f"Binary `{record['binary']}`, seed {record['seed']}, {record['minutes']:.1f} minutes on "
        f"{record['jobs']} processes. Recipes: {', '.join(record['recipes'])}.",
        "",
        f"**{sum(kind['times'] for kind in record['kinds'])} faults of {len(record['kinds'])} kinds.**",
        "",
    ]
    if record["without_config"]:
        names = ", ".join(record["without_config"])
        lines += [f"NOT ATTACKED, because no small config trains: {names}.", ""]
    if record["formats_left_out"]:
        names = ", ".join(record["formats_left_out"])
        lines += [f"NOT ATTACKED, because no command takes a valid file: {names}.", ""]
    for name, reason in record["not_applicable"].items():
        lines += [f"Not applicable: {name}: {reason}.", ""]
    lines += [
        "| attack | cases | of | faults | minutes | counts | peak MiB | slowest, CPU s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for attack in record["attacks"]:
        counts = {k: v for k, v in attack["counts"].items() if not k.startswith(FORMAT_PREFIX)}
        said = ", ".join(f"{name} {count}" for name, count in counts.items())
        lines.append(
            f"| {attack['attack']} | {attack['cases']} | {attack['of'] or ''} | {attack['faults']} "
            f"| {attack['seconds'] / 60:.1f} | {said} | {attack['peak_mib']} "
            f"| {attack['slowest_cpu_seconds']} |"
        )
    formats = {
        name.removeprefix(FORMAT_PREFIX): count
        for attack in record["attacks"]
        for name, count in attack["counts"].items()
        if name.startswith(FORMAT_PREFIX)
    }
    if formats:
        lines += ["", f"## Files by format: {sum(formats.values())}", ""]
        lines += [f"- {name}: {count}" for name, count in formats.items()]
    if record["kinds"]:
        lines += ["", "## Faults by kind", "", "| times | attack | kind | what |", "|---|---|---|---|"]
    for kind in record["kinds"]:
        what = kind["signature"].replace("|", "\\|")
        lines.append(f"| {kind['times']} | {kind['attack']} | {kind['kind']} | {what} |")
    if record["findings"]:
        lines += ["", "## Findings", ""]
    for finding in record["findings"]:
        found = " ".join(finding["found"].split())[:300]
        lines.append(f"- `{finding['name']}` ({finding['case']}, {finding['about']}): {found}")
        if finding["command"]:
            lines.append(f"  `{finding['command'][:300]}`")
    if record["broken"]:
        lines += ["", "## Cases that the campaign itself could not carry out", ""]
        lines += [f"```\n{case}```" for case in record["broken"]]
    return "\n".join(lines) + "\n"
