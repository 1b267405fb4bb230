/* Generated from decay. */
#ifndef MODEL_H
#define MODEL_H
#define MODEL_IDENTIFIER "hostile"
#define MODEL_PREFIX hostile_
#define MODEL_NAME "decay"
#define MODEL_GUID "{5dbe4177-dd0a-45d4-89bc-7a68968f9d38}"
#define NX 1
#define NZ 0
#define NU 1
#define NP 1
#define NY 1
#define N_LIMITS 0
#define HAS_VALID 0
#define DEFAULT_TOLERANCE 1e-09
#define HAS_ADJOINT 0
#define SOLVER_DOP853 1
#define LARGEST_STEP 0.02
#define MOST_TRIALS 20000
#endif
