# Compile a shared library with TinyCC, or with another compiler what TinyCC lacks.
#   sh quick_compiler.sh TCC FOLDER_OF_TCC MULTIARCH COMPILER ARGUMENTS...
# FOLDER_OF_TCC holds its own library and headers; MULTIARCH is the name of the folder of the
# system's libraries and headers for this processor.
tcc=$1 own=$2 multiarch=$3 compiler=$4
shift 4
compiles() {
    for word; do
        shift
        case $word in
        -Wl,--gc-sections) continue ;; # unknown to TinyCC
        *.c) grep -q pthread_create "$word" && return 1 ;; # each needs variables of its own
        esac
        set -- "$@" "$word"
    done
    # a library needs no start files, which TinyCC looks for in other folders
    "$tcc" "-B$own" "-I/usr/include/$multiarch" "-L/usr/lib/$multiarch" "-L/lib/$multiarch" \
        -D_Thread_local= -nostdlib "$@" -lc "$own/libtcc1.a" >/dev/null 2>&1
}
case " $* " in *" -shared "*) compiles "$@" && exit ;; esac
exec "$compiler" "$@"
