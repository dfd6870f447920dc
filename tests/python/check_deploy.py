"""Reads the files in deploy/ as the systems they are for would: Kubernetes' own schemas, PromQL's own grammar."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import kubernetes_validate
import promql_parser
import yaml

DEPLOY = Path(__file__).parents[2] / "deploy"


def manifests() -> Iterator[tuple[str, dict]]:
    for file in sorted((DEPLOY / "kubernetes").glob("*.yaml")):
        # What kustomize reads is no object of a cluster.
        if file.name != "kustomization.yaml":
            yield from ((file.name, document) for document in yaml.safe_load_all(file.read_text()))


def expressions() -> Iterator[tuple[str, str]]:
    alerts = yaml.safe_load((DEPLOY / "prometheus/alerts.yml").read_text())
    for group in alerts["groups"]:
        yield from ((rule["alert"], rule["expr"]) for rule in group["rules"])
    board = json.loads((DEPLOY / "grafana/furrow.json").read_text())
    for panel in board["panels"]:
        # Grafana puts a length of time in place of its variable.
        yield from ((panel["title"], target["expr"].replace("$__rate_interval", "1m")) for target in panel["targets"])


def main() -> None:
    objects = list(manifests())
    for name, manifest in objects:
        try:
            kubernetes_validate.validate(manifest, kubernetes_validate.latest_version(), strict=True)
        except kubernetes_validate.ValidationError as error:
            sys.exit(f"{name}: {manifest['kind']} {manifest['metadata']['name']}: {error}")
    asked = list(expressions())
    for name, expression in asked:
        try:
            promql_parser.parse(expression)
        except ValueError as error:
            sys.exit(f"{name}: {expression}: {error}")
    if len(objects) < 8 or len(asked) < 15:
        sys.exit(f"only {len(objects)} manifests and {len(asked)} expressions were found")
    print(f"{len(objects)} manifests by Kubernetes' schemas, {len(asked)} expressions by PromQL's grammar")


main()
