"""What Debian's Prometheus makes of the files of `deploy/`: it reads them, and each alert fires in its scene."""

import json
import re
import shutil
import signal
import subprocess
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from ruamel.yaml import YAML

from health.causes import Cause
from tests.layouts import slow_layout
from tests.processes import Processes, free_endpoint, free_port
from views.metrics.command import EXPECTED
from views.metrics.exporter import Exporter

ROOT = Path(__file__).parents[3]
RULES, DASHBOARD = ROOT / "deploy/prometheus/canskin.rules.yml", ROOT / "deploy/grafana/canskin.json"
TOOLS = ROOT / "build/prometheus"
CAUSE = '{code="%s", level="%s", instance="robot:8767", skin="palm", subject="here"}'
#: By alert: what is scraped every 15 s, and when the alert fires.
SCENES: dict[str, tuple[dict[str, str], str]] = {
    "CanskinAbsent": ({'up{job="canskin"}': "0x20"}, "90s"),
    "CanskinServiceDown": ({'canskin_up{skin="palm", service="reconstructor"}': "1x3 0x20"}, "75s"),
    "CanskinError": ({f"canskin_cause{CAUSE % ('bus-off', 'error')}": "1x20"}, "30s"),
    "CanskinWarning": ({f"canskin_cause{CAUSE % ('node-silent', 'warning')}": "1x20"}, "90s"),
    "CanskinNotStarted": (  # an optional board may be away for ever
        {f"canskin_cause{CAUSE % (code, 'info')}": "1x90" for code in ("starting", "node-away")}, "11m"
    ),
    "CanskinBusLoad": ({'canskin_bus_load_ratio{skin="palm", bus="left"}': "0.93x40"}, "5m"),
    "CanskinLatency": (
        {
            'canskin_sync_to_image_seconds_bucket{skin="palm", le="0.05"}': "0+900x20",
            'canskin_sync_to_image_seconds_bucket{skin="palm", le="0.1"}': "0+1000x20",
            'canskin_sync_to_image_seconds_bucket{skin="palm", le="+Inf"}': "0+1000x20",
        },
        "4m",
    ),
    "CanskinCyclesIncomplete": (
        {'canskin_cycles_total{skin="palm"}': "0+1000x20", 'canskin_cycles_complete_total{skin="palm"}': "0+980x20"},
        "4m",
    ),
}  # fmt: skip
#: What a person reads of a cause.
NAMED = {
    "exp_labels": {
        "severity": "critical", "instance": "robot:8767", "skin": "palm", "code": "bus-off", "level": "error",
        "subject": "here", "sees": Cause.BUS_OFF.sees, "mend": "do",
    },
    "exp_annotations": {"summary": f"palm: {Cause.BUS_OFF.sees} (bus-off, here)", "description": "do"},
}  # fmt: skip


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of Debian's `prometheus` and `promtool`, unpacked and not installed."""
    found = TOOLS / "usr/bin"
    if not (found / "promtool").exists():
        if shutil.which("apt-get") is None or shutil.which("dpkg") is None:
            pytest.skip("NOT TESTED: no apt-get to fetch Prometheus with")
        folder = tmp_path_factory.mktemp("debian")
        for words in (["download", "prometheus"], ["update"], ["download", "prometheus"]):
            done = subprocess.run(["apt-get", "-qq", *words], cwd=folder, check=False, capture_output=True)
            if not done.returncode and (packages := list(folder.glob("*.deb"))):
                break
        else:
            pytest.skip("NOT TESTED: the Debian package prometheus cannot be downloaded")
        TOOLS.mkdir(parents=True, exist_ok=True)
        subprocess.run(["dpkg", "-x", str(packages[0]), str(TOOLS)], check=True)
    return found


def promtool(tools: Path, *words: str, given: bytes | None = None) -> None:
    done = subprocess.run([str(tools / "promtool"), *words], input=given, capture_output=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr).decode()


def read(path: Path) -> Any:
    return YAML(typ="safe").load(path)


def exported() -> str:
    registry = CollectorRegistry()
    registry.register(Exporter("", EXPECTED))
    return generate_latest(registry).decode()


def names(text: str) -> set[str]:
    return set(re.findall(r"\bcanskin_\w+", text))


def expressions() -> dict[str, str]:
    """Return the expressions of the dashboard, each with the title of its panel."""
    panels = json.loads(DASHBOARD.read_text())["panels"]
    return {f"{panel['title']} {target['refId']}": target["expr"] for panel in panels for target in panel["targets"]}


@pytest.mark.heavy
def test_promtool_finds_no_fault_in_figures_and_rules(tools: Path) -> None:
    promtool(tools, "check", "metrics", given=exported().encode())
    promtool(tools, "check", "rules", str(RULES))


@pytest.mark.heavy
def test_every_expression_of_the_dashboard_is_one(tools: Path, tmp_path: Path) -> None:
    rules = [{"record": f"panel:{number}", "expr": each} for number, each in enumerate(expressions().values())]
    path = tmp_path / "dashboard.json"  # JSON is YAML
    path.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    promtool(tools, "check", "rules", str(path))


def test_rules_and_dashboard_ask_for_figures_that_are_there() -> None:
    known = names(exported()) | {f"canskin_sync_to_image_seconds_{part}" for part in ("bucket", "count", "sum")}
    asked = [rule["expr"] for rule in read(RULES)["groups"][0]["rules"]] + list(expressions().values())
    assert names(" ".join(asked)) <= known


def test_each_alert_has_a_severity_words_and_a_scene() -> None:
    rules = read(RULES)["groups"][0]["rules"]
    assert [rule["alert"] for rule in rules] == list(SCENES)
    for rule in rules:
        assert rule["for"]
        assert rule["labels"]["severity"] in {"critical", "warning"}
        assert set(rule["annotations"]) == {"summary", "description"}


@pytest.mark.heavy
def test_each_alert_fires_in_its_scene_and_no_other_does(tools: Path, tmp_path: Path) -> None:
    tests: list[dict[str, Any]] = []
    for alert, (series, when) in SCENES.items():
        told = {} if alert == "CanskinAbsent" else {'canskin_up{skin="palm", service="gateway"}': "1x90"}
        told |= {
            f'canskin_cause_info{{instance="robot:8767", code="{cause.code}", sees="{cause.sees}", mend="do"}}': "1x90"
            for cause in Cause
        }
        firing = {"labels": f'{{alertname="{alert}"}}', "value": 1}
        query = 'count by (alertname) (ALERTS{alertstate="firing"})'
        tests.append(
            {
                "interval": "15s",
                "input_series": [{"series": name, "values": values} for name, values in {**told, **series}.items()],
                "promql_expr_test": [{"expr": query, "eval_time": when, "exp_samples": [firing]}],
            }
        )
    tests[2]["alert_rule_test"] = [{"alertname": "CanskinError", "eval_time": "30s", "exp_alerts": [NAMED]}]
    path = tmp_path / "scenes.json"
    path.write_text(json.dumps({"rule_files": [str(RULES)], "evaluation_interval": "5s", "tests": tests}))
    promtool(tools, "test", "rules", str(path))


def asked(port: int, path: str) -> Any:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/{path}", timeout=60) as answer:
            return json.load(answer)["data"]
    except OSError:  # it has not started yet
        return {"result": [], "alerts": []}


def up(port: int) -> set[str]:
    found = asked(port, "query?query=canskin_up")["result"]
    return {each["metric"]["service"] for each in found if each["value"][1] == "1"}


def firing(port: int) -> set[tuple[str, str]]:
    alerts = [each["labels"] for each in asked(port, "alerts")["alerts"] if each["state"] == "firing"]
    return {(each["alertname"], each.get("code") or each.get("service", "")) for each in alerts}


@pytest.mark.slow
def test_prometheus_alerts_when_a_service_is_killed(tools: Path, tmp_path: Path) -> None:
    layout, endpoint = str(slow_layout(tmp_path, 20)), free_endpoint()
    exporter, port = free_port(), free_port()
    config = tmp_path / "prometheus.json"
    config.write_text(
        json.dumps(
            {
                "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
                "rule_files": [str(RULES)],
                "scrape_configs": [
                    {"job_name": "canskin", "static_configs": [{"targets": [f"127.0.0.1:{exporter}"]}]},
                ],
            }
        )
    )
    where = [
        f"--config.file={config}",
        f"--storage.tsdb.path={tmp_path}/data",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    with Processes(tmp_path) as running:
        running.start("prometheus", str(tools / "prometheus"), "--log.level=warn", *where)
        running.skin("metrics", "metrics", "--connect", endpoint, "--port", str(exporter))
        running.skin("hub", "hub", "--listen", endpoint)
        running.skin("bus", "bus", "--layout", layout)
        running.await_words("bus", "ready")
        for verb in ("nodes", "gateway", "reconstruct"):
            running.skin(verb, verb, "--layout", layout, "--connect", endpoint)
        running.until(lambda: up(port) == {"gateway", "reconstructor"}, "all services up", every_s=0.5)
        assert running.stop("reconstruct", signal.SIGKILL) == -signal.SIGKILL
        wanted = {("CanskinServiceDown", "reconstructor"), ("CanskinError", "service-gone")}
        running.until(lambda: firing(port) >= wanted, f"{wanted}", every_s=0.5)
        assert up(port) == {"gateway"}
