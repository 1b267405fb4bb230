"""`cosim --print-completion bash|zsh|fish`: a script that completes verbs and options."""

import argparse
from collections.abc import Sequence
from typing import Any

from cosim.cli.options import Parser, did_you_mean

SHELLS = ("bash", "zsh", "fish")

_BASH = """_cosim() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} verb=${{COMP_WORDS[1]}} words
    if [ "$COMP_CWORD" -eq 1 ]; then words="{verbs}"; else case "$verb" in
{cases}
    esac; fi
    COMPREPLY=($(compgen -W "$words" -- "$word") $(compgen -f -- "$word"))
}}
complete -o default -F _cosim cosim
"""


class PrintCompletion(argparse.Action):
    """Print a script for a shell, and end."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        _namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        _option: str | None = None,
    ) -> None:
        """Print the script."""
        assert isinstance(parser, Parser)
        if values not in SHELLS:
            near = did_you_mean(str(values), SHELLS) or f"; give {', '.join(SHELLS)}"
            parser.exit(3, f"cosim: no shell '{values}'{near}\n")
        print(script(parser, str(values)), end="")
        parser.exit(0)


def script(parser: Parser, shell: str) -> str:
    """Return the script for one of `SHELLS`."""
    verbs = {
        name: [o for o in p.options() if o.startswith("--")] for name, p in parser.verbs().items()
    }
    if shell == "fish":
        lines = [f"complete -c cosim -n __fish_use_subcommand -f -a '{' '.join(verbs)}'"]
        for verb, options in verbs.items():
            seen = f"__fish_seen_subcommand_from {verb}"
            lines += [f"complete -c cosim -n '{seen}' -l {option[2:]}" for option in options]
        return "\n".join(lines) + "\n"
    cases = "\n".join(f'        {verb}) words="{" ".join(o)}" ;;' for verb, o in verbs.items())
    text = _BASH.format(verbs=" ".join(verbs), cases=cases)
    return text if shell == "bash" else f"autoload -U +X bashcompinit && bashcompinit\n{text}"
