#if defined __GNUC__ && !defined _WIN32
#define COSIM_VISIBLE _Pragma("GCC visibility push(default)")
#define COSIM_HIDDEN _Pragma("GCC visibility push(hidden)")
#define COSIM_END _Pragma("GCC visibility pop")
#else
#define COSIM_VISIBLE
#define COSIM_HIDDEN
#define COSIM_END
#endif
#define CASADI_SYMBOL_EXPORT
COSIM_HIDDEN
