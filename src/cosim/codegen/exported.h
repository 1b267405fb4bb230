#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(default)
#elif defined _WIN32
#define CASADI_SYMBOL_EXPORT __declspec(dllexport)
#endif
