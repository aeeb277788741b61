"""Reads manifests from standard input, checks each against its schema, and prints all of them as JSON.

Kubernetes' own kinds are held against its strict JSON schemas, for every version given; the Prometheus operator's against
the types that are made of its CRDs. An unknown or misspelt field is an error in both. Ends with 1 and a line for each.
"""

import json
import sys

import kubernetes_validate
import yaml


def operator_problems(document: dict) -> list[str]:
    from cloudcoil.models.prometheus_operator import v1

    model = getattr(v1, document["kind"]).model_validate(document)
    kept = json.loads(model.model_dump_json(by_alias=True, exclude_unset=True))
    return differences(document, kept, "")


def differences(given, kept, path: str) -> list[str]:
    """Where a document lost something on its way through its type: those fields do not exist."""
    if isinstance(given, dict) and isinstance(kept, dict):
        lost = [f"{path}.{key} does not exist" for key in given if key not in kept]
        return lost + [line for key in kept for line in differences(given.get(key), kept[key], f"{path}.{key}")]
    if isinstance(given, list) and isinstance(kept, list):
        pairs = enumerate(zip(given, kept, strict=True))
        return [line for i, (a, b) in pairs for line in differences(a, b, f"{path}[{i}]")]
    return [] if given == kept else [f"{path} is {given!r} and was read as {kept!r}"]


def problems(document: dict, versions: list[str]) -> list[str]:
    if document["apiVersion"].startswith("monitoring.coreos.com/"):
        try:
            return operator_problems(document)
        except ValueError as error:
            return [str(error)]
    found = []
    for version in versions:
        try:
            kubernetes_validate.validate(document, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            place = ".".join(str(part) for part in error.path)
            found.append(f"{place}: {error.message} (Kubernetes {version})")
        except kubernetes_validate.SchemaNotFoundError as error:
            found.append(error.message)
    return found


def main() -> int:
    documents = [document for document in yaml.safe_load_all(sys.stdin) if document]
    failed = False
    for document in documents:
        for problem in problems(document, sys.argv[1:]):
            failed = True
            print(f"{document['kind']} {document['metadata']['name']}: {problem}", file=sys.stderr)
    json.dump(documents, sys.stdout)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
