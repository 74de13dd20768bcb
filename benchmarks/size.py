"""Size of the package and its tests against their budget, `size.json` beside this file: its numbers may only fall.

Statements are nodes of the syntax tree. A constant is a name in capitals at a module's top whose value holds a number.
`--lower` writes the size that was reached as the new budget.
"""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

HERE = Path(__file__).parent
BUDGET = HERE / "size.json"
FOLDERS = ("deepir", "tests")


def size(folder: Path) -> dict[str, int]:
    """Files, lines, statements and numeric constants of the Python below a folder."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))]
    trees = [ast.parse(text) for text in texts]
    return {
        "files": len(texts),
        "lines": sum(len(text.splitlines()) for text in texts),
        "statements": sum(isinstance(node, ast.stmt) for tree in trees for node in ast.walk(tree)),
        "constants": sum(is_numeric_constant(node) for tree in trees for node in tree.body),
    }


def is_numeric_constant(node: ast.stmt) -> bool:
    """Whether a statement gives a name in capitals a value with a number in it."""
    nodes = list(ast.walk(node)) if isinstance(node, ast.Assign | ast.AnnAssign) else []
    stored = [each.id for each in nodes if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)]
    values = [each.value for each in nodes if isinstance(each, ast.Constant)]
    return any(map(str.isupper, stored)) and any(type(value) in (int, float) for value in values)


def main() -> int:
    sizes = {name: size(HERE.parent / name) for name in FOLDERS}
    budget = json.loads(BUDGET.read_text(encoding="utf-8"))
    over = []
    for name, found in sizes.items():
        print(f"{name}: " + ", ".join(f"{count:,} {what}" for what, count in found.items()))
        over += [
            f"{name} has {count:,} {what}, its budget is {budget[name][what]:,}"
            for what, count in found.items()
            if count > budget[name][what]
        ]
    if "--lower" in sys.argv and not over:
        BUDGET.write_text(json.dumps(sizes, indent=2) + "\n", encoding="utf-8")
    print("\n".join(over), end="\n" if over else "")
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main())
