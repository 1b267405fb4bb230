"""Every rule that an FMU is held to without running it: name, level, importers, cure.

Where two rules have one name, they differ in how much depends on them. What a rule says of
importers was seen with the tools of `docs/importers.md`, or follows from the FMI's own words.
"""

from cosim.fmi.check.finding import ADVICE, HOUSE, WRONG, Rule

# fmt: off

# Archive
ENTRY_NAME = Rule("entry-name", ADVICE,
    "unpack it under another name, or not at all, on some systems", "name files in ASCII, with /")
COMPRESSION = Rule("compression", WRONG, "many cannot unpack it", "pack with method deflate")
ARCHIVE = Rule("archive", WRONG, "cannot unpack it", "pack the file again")

# Head of the description
XML = Rule("xml", WRONG, "cannot read the file", "write well-formed XML")
SCHEMA = Rule("schema", WRONG,
    "those that validate refuse the file, as fmpy --validate does", "write what the schema allows")
VERSION = Rule("version", WRONG,
    "read FMI 1.0 by other rules, other versions not at all", "give an FMU of FMI 2.0 or 3.0")
TOKEN = Rule("token", WRONG, "have nothing to instantiate it with", "give the token a value")
INTERFACE = Rule("interface", WRONG, "have nothing to run", "declare an interface")
IDENTIFIER = Rule("identifier", WRONG,
    "look for a library or function that cannot exist", "use letters, digits and _ only")
EXPERIMENT = Rule("experiment", ADVICE,
    "take it as their default and fail, or take their own", "give finite numbers, stop after start")

# Units
UNIT = Rule("unit", WRONG,
    "refuse the file, or convert by a wrong factor", "define each unit once, with finite factors")
UNIT_HOUSE = Rule("unit", HOUSE, "do not convert it", "give base units to what is used")
UNIT_OF_RATE = Rule("unit-of-rate", ADVICE,
    "show the derivative in a unit that is not its own", "make it the state's unit per s")

# Variables
NAME = Rule("name", WRONG, "mix the variables up, or refuse the file", "name every variable once")
CAUSALITY = Rule("causality", WRONG,
    "those that validate refuse the file", "see the table of `initial` in the FMI")
VARIABILITY = Rule("variability", WRONG,
    "those that validate refuse the file", "make it discrete")
START = Rule("start", WRONG,
    "begin with 0, or refuse the file", "a start with exact, approx, input")
NUMBER = Rule("number", WRONG, "spread it through all results", "write a finite number")
BOUNDS = Rule("bounds", WRONG,
    "refuse to start, or clip the value", "put start between min and max")
NOMINAL = Rule("nominal", WRONG,
    "divide by it where they scale tolerances", "write a nominal value above 0")
DERIVATIVE = Rule("derivative", WRONG, "count other states than there are", "name its state")
REFERENCES = Rule("value-reference", HOUSE, "do not care", "number from 0 without gaps")
SHARED_REFERENCE = Rule("value-reference", WRONG,
    "read and write one variable for another", "number every variable once")
ALIAS = Rule("value-reference", HOUSE, "take them for one variable", "number every variable once")

# Model structure
ORDER = Rule("order", HOUSE, "do not care", "list in ascending order")
LISTED = Rule("structure", WRONG,
    "miss a state or an output, or refuse the file", "list every variable of its kind there, once")
LISTED_LIGHTLY = Rule("structure", ADVICE,
    "leave it out where they solve loops or make functions of the FMU", LISTED.cure)
REFERS = Rule("structure", WRONG,
    "refuse the file, or read beyond a list", "name what is described")
KNOWNS = Rule("dependencies", HOUSE, "ignore it", "list knowns only")  # many list parameters

# Sources
SOURCES = Rule("sources", WRONG,
    "cannot compile it for their own platform", "add the file or do not list it")

# Libraries
BINARY = Rule("binary", WRONG,
    "find nothing to load", "name the library like modelIdentifier, 64-bit")
NOTHING_TO_RUN = Rule("binary", WRONG,
    "have nothing to load and nothing to compile", "add a library, or sources")
TOKEN_ELSEWHERE = Rule("token", ADVICE,
    "are refused by the library if it is another's", "check with --run that it instantiates")
FUNCTIONS = Rule("functions", WRONG,
    "stop when they load it, or crash at the call", "export every function of its interfaces")
PLATFORM = Rule("platform", WRONG,
    "cannot load it", "put the library into its own platform's folder")
FOLDER = Rule("platform", ADVICE,
    "do not look there", "name it as the FMI does: linux64 in FMI 2.0, x86_64-linux in FMI 3.0")
IMPORTS = Rule("imports", ADVICE,
    "cannot load it on computers without them", "link statically, or put it beside the library")
UNDEFINED = Rule("undefined", ADVICE,
    "fail at loading or crash, unless they hold that library themselves",
    "link it with the library that has them")
GLIBC = Rule("glibc", ADVICE,
    "cannot load it on older systems", "compile it on an older system, or for glibc 2.17 with zig")
MACOS = Rule("macos", ADVICE,
    "cannot load it on older systems", "compile with -mmacosx-version-min=11.0")
RUN_PATH = Rule("run-path", ADVICE,
    "load what lies there on their computer, or nothing",
    "link without a run path, or with $ORIGIN (macOS: @loader_path)")
