#include <math.h>
#include "visibility.h"
INSIDE_BEGIN
#define CASADI_SYMBOL_EXPORT
#if defined __GNUC__
#define SMALL __attribute__((cold)) /* compiled for size */
#else
#define SMALL
#endif
/* How to prefix internal symbols */
#ifdef CASADI_CODEGEN_PREFIX
  #define CASADI_NAMESPACE_CONCAT(NS, ID) _CASADI_NAMESPACE_CONCAT(NS, ID)
  #define _CASADI_NAMESPACE_CONCAT(NS, ID) NS ## ID
  #define CASADI_PREFIX(ID) CASADI_NAMESPACE_CONCAT(CODEGEN_PREFIX, ID)
#else
  #define CASADI_PREFIX(ID) hostile_equations_ ## ID
#endif

#include <math.h>

#ifndef casadi_real
#define casadi_real double
#endif

#ifndef casadi_int
#define casadi_int long long int
#endif

/* Add prefix to internal symbols */
#define casadi_copy CASADI_PREFIX(copy)
#define casadi_f0 CASADI_PREFIX(f0)
#define casadi_f1 CASADI_PREFIX(f1)
#define casadi_f2 CASADI_PREFIX(f2)
#define casadi_f3 CASADI_PREFIX(f3)
#define casadi_f4 CASADI_PREFIX(f4)
#define casadi_f5 CASADI_PREFIX(f5)
#define casadi_f6 CASADI_PREFIX(f6)
#define casadi_f7 CASADI_PREFIX(f7)
#define casadi_f8 CASADI_PREFIX(f8)
#define casadi_s0 CASADI_PREFIX(s0)
#define casadi_s1 CASADI_PREFIX(s1)
#define casadi_s2 CASADI_PREFIX(s2)

/* Symbol visibility in DLLs */
#ifndef CASADI_SYMBOL_EXPORT
  #if defined(_WIN32) || defined(__WIN32__) || defined(__CYGWIN__)
    #if defined(STATIC_LINKED)
      #define CASADI_SYMBOL_EXPORT
    #else
      #define CASADI_SYMBOL_EXPORT __declspec(dllexport)
    #endif
  #elif defined(__GNUC__) && defined(GCC_HASCLASSVISIBILITY)
    #define CASADI_SYMBOL_EXPORT __attribute__ ((visibility ("default")))
  #else
    #define CASADI_SYMBOL_EXPORT
  #endif
#endif

void casadi_copy(const casadi_real* x, casadi_int n, casadi_real* y) {
  casadi_int i;
  if (y) {
    if (x) {
      for (i=0; i<n; ++i) *y++ = *x++;
    } else {
      for (i=0; i<n; ++i) *y++ = 0.;
    }
  }
}

/* Configuration this file was compiled with */
CASADI_SYMBOL_EXPORT void hostile_equations_casadi_version(int* major, int* minor, int* patch) {
  *major = 3;
  *minor = 8;
  *patch = 2;
}
CASADI_SYMBOL_EXPORT int hostile_equations_casadi_int_size(void) { return (int) sizeof(casadi_int); }
CASADI_SYMBOL_EXPORT int hostile_equations_casadi_real_size(void) { return (int) sizeof(casadi_real); }

static const casadi_int casadi_s0[3] = {1, 1, 1};
static const casadi_int casadi_s1[3] = {0, 1, 1};
static const casadi_int casadi_s2[3] = {1, 2, 1};

/* hostile_model_start:(x,p)->(x_start,defect) */
static int casadi_f0(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real w0;
 /* #0: @0 = input[0][0] */
 w0 = arg[0] ? arg[0][0] : 0;
 /* #1: output[0][0] = @0 */
 if (res[0]) res[0][0] = w0;
 /* #2: @0 = 0 */
 w0 = 0.;
 /* #3: output[1][0] = @0 */
 if (res[1]) res[1][0] = w0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_start(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f0(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_start_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_start_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_start_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_start_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_start_n_in(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_start_n_out(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_start_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_start_name_in(casadi_int i) {
 switch (i) {
  case 0: return "x";
  case 1: return "p";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_start_name_out(casadi_int i) {
 switch (i) {
  case 0: return "x_start";
  case 1: return "defect";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_start_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_start_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_start_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 2;
 if (sz_res) *sz_res = 3;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_start_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 3*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 0*sizeof(casadi_real);
 return 0;
}

/* hostile_model_algebraic:(t,x,z[0],u,p)->(z_solved[0]) */
static int casadi_f1(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_algebraic(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f1(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_algebraic_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_algebraic_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_algebraic_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_algebraic_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_algebraic_n_in(void) { return 5;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_algebraic_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_algebraic_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_algebraic_name_in(casadi_int i) {
 switch (i) {
  case 0: return "t";
  case 1: return "x";
  case 2: return "z";
  case 3: return "u";
  case 4: return "p";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_algebraic_name_out(casadi_int i) {
 switch (i) {
  case 0: return "z_solved";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_algebraic_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s1;
  case 3: return casadi_s0;
  case 4: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_algebraic_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s1;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_algebraic_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5;
 if (sz_res) *sz_res = 1;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_algebraic_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 1*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 0*sizeof(casadi_real);
 return 0;
}

/* hostile_model_ode:(t,x,z[0],u,p)->(value) */
static int casadi_f2(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2;
 a0=arg[3]? arg[3][0] : 0;
 a1=arg[4]? arg[4][0] : 0;
 a2=arg[1]? arg[1][0] : 0;
 if (res[0]!=0) res[0][0]=(a0-(a1*a2));
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_ode(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f2(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_ode_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_ode_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_ode_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_ode_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_ode_n_in(void) { return 5;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_ode_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_ode_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_ode_name_in(casadi_int i) {
 switch (i) {
  case 0: return "t";
  case 1: return "x";
  case 2: return "z";
  case 3: return "u";
  case 4: return "p";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_ode_name_out(casadi_int i) {
 switch (i) {
  case 0: return "value";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_ode_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s1;
  case 3: return casadi_s0;
  case 4: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_ode_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_ode_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5;
 if (sz_res) *sz_res = 1;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_ode_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 1*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 0*sizeof(casadi_real);
 return 0;
}

/* hostile_model_outputs:(t,x,z[0],u,p)->(value,margins[0]) */
static int casadi_f3(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0;
 a0=arg[1]? arg[1][0] : 0;
 if (res[0]!=0) res[0][0]=(2.*a0);
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_outputs(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f3(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_outputs_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_outputs_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_outputs_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_outputs_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_outputs_n_in(void) { return 5;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_outputs_n_out(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_outputs_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_outputs_name_in(casadi_int i) {
 switch (i) {
  case 0: return "t";
  case 1: return "x";
  case 2: return "z";
  case 3: return "u";
  case 4: return "p";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_outputs_name_out(casadi_int i) {
 switch (i) {
  case 0: return "value";
  case 1: return "margins";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_outputs_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s1;
  case 3: return casadi_s0;
  case 4: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_outputs_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s1;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_outputs_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5;
 if (sz_res) *sz_res = 2;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_outputs_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 5*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 2*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 0*sizeof(casadi_real);
 return 0;
}

/* along_all:(i0,i1,i2[0],i3,i4,i5,i6,i7,i8,i9[0])->(o0,o1) */
SMALL static int casadi_f5(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2, a3;
 a0=arg[6]? arg[6][0] : 0;
 a1=arg[1]? arg[1][0] : 0;
 a2=arg[7]? arg[7][0] : 0;
 a1=(a1*a2);
 a2=arg[4]? arg[4][0] : 0;
 a3=arg[5]? arg[5][0] : 0;
 if (res[0]!=0) res[0][0]=(a0-(a1+(a2*a3)));
 if (res[1]!=0) res[1][0]=(2.*a3);
 return 0;
}

/* hostile_model_directional:(i0,i1,i2[0],i3,i4,i5,i6,i7,i8)->(o0,o1[0],o2) */
static int casadi_f4(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real **res1=res+3, w00, w01, w03, w04, w05, w06, w07, w08, w10, w11;
  const casadi_real **arg1=arg+9;
 /* #0: @0 = input[0][0] */
 w00 = arg[0] ? arg[0][0] : 0;
 /* #1: @1 = input[1][0] */
 w01 = arg[1] ? arg[1][0] : 0;
 /* #2: @2 = 0x1 */
 /* #3: @3 = input[3][0] */
 w03 = arg[3] ? arg[3][0] : 0;
 /* #4: @4 = input[4][0] */
 w04 = arg[4] ? arg[4][0] : 0;
 /* #5: @5 = input[5][0] */
 w05 = arg[5] ? arg[5][0] : 0;
 /* #6: @6 = input[6][0] */
 w06 = arg[6] ? arg[6][0] : 0;
 /* #7: @7 = input[7][0] */
 w07 = arg[7] ? arg[7][0] : 0;
 /* #8: @8 = input[8][0] */
 w08 = arg[8] ? arg[8][0] : 0;
 /* #9: @9 = 0x1 */
 /* #10: {@10, @11} = along_all(@0, @1, @2, @3, @4, @5, @6, @7, @8, @9) */
 arg1[0]=(&w00);
 arg1[1]=(&w01);
 arg1[2]=0;
 arg1[3]=(&w03);
 arg1[4]=(&w04);
 arg1[5]=(&w05);
 arg1[6]=(&w06);
 arg1[7]=(&w07);
 arg1[8]=(&w08);
 arg1[9]=0;
 res1[0]=(&w10);
 res1[1]=(&w11);
 if (casadi_f5(arg1, res1, iw, w, 0)) return 1;
 /* #11: output[0][0] = @10 */
 if (res[0]) res[0][0] = w10;
 /* #12: output[2][0] = @11 */
 if (res[2]) res[2][0] = w11;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_directional(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f4(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_directional_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_directional_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_directional_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_directional_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_directional_n_in(void) { return 9;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_directional_n_out(void) { return 3;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_directional_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_directional_name_in(casadi_int i) {
 switch (i) {
  case 0: return "i0";
  case 1: return "i1";
  case 2: return "i2";
  case 3: return "i3";
  case 4: return "i4";
  case 5: return "i5";
  case 6: return "i6";
  case 7: return "i7";
  case 8: return "i8";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_directional_name_out(casadi_int i) {
 switch (i) {
  case 0: return "o0";
  case 1: return "o1";
  case 2: return "o2";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_directional_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s1;
  case 3: return casadi_s0;
  case 4: return casadi_s0;
  case 5: return casadi_s0;
  case 6: return casadi_s0;
  case 7: return casadi_s0;
  case 8: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_directional_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s1;
  case 2: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_directional_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 19;
 if (sz_res) *sz_res = 5;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 4;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_directional_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 19*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 5*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 4*sizeof(casadi_real);
 return 0;
}

/* blocks:(i0,i1,i2[0],i3,i4)->(o0[1x2],o1[1x0],o2[0x2],o3[]) */
SMALL static int casadi_f7(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0;
 a0=arg[4]? arg[4][0] : 0;
 if (res[0]!=0) res[0][0]=(-a0);
 if (res[0]!=0) res[0][1]=1.;
 return 0;
}

/* hostile_model_jacobian:(i0,i1,i2[0],i3,i4)->(o0[1x2],o1[0]) */
static int casadi_f6(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real **res1=res+2, w0, w1, w3, w4, *w5=w+1;
  const casadi_real **arg1=arg+5;
 /* #0: @0 = input[0][0] */
 w0 = arg[0] ? arg[0][0] : 0;
 /* #1: @1 = input[1][0] */
 w1 = arg[1] ? arg[1][0] : 0;
 /* #2: @2 = 0x1 */
 /* #3: @3 = input[3][0] */
 w3 = arg[3] ? arg[3][0] : 0;
 /* #4: @4 = input[4][0] */
 w4 = arg[4] ? arg[4][0] : 0;
 /* #5: {@5, NULL, NULL, NULL} = blocks(@0, @1, @2, @3, @4) */
 arg1[0]=(&w0);
 arg1[1]=(&w1);
 arg1[2]=0;
 arg1[3]=(&w3);
 arg1[4]=(&w4);
 res1[0]=w5;
 res1[1]=0;
 res1[2]=0;
 res1[3]=0;
 if (casadi_f7(arg1, res1, iw, w, 0)) return 1;
 /* #6: output[0][0] = @5 */
 casadi_copy(w5, 2, res[0]);
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_jacobian(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f6(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_jacobian_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_jacobian_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_jacobian_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_jacobian_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_jacobian_n_in(void) { return 5;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_jacobian_n_out(void) { return 2;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_jacobian_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_jacobian_name_in(casadi_int i) {
 switch (i) {
  case 0: return "i0";
  case 1: return "i1";
  case 2: return "i2";
  case 3: return "i3";
  case 4: return "i4";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_jacobian_name_out(casadi_int i) {
 switch (i) {
  case 0: return "o0";
  case 1: return "o1";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_jacobian_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s1;
  case 3: return casadi_s0;
  case 4: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_jacobian_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s2;
  case 1: return casadi_s1;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_jacobian_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 10;
 if (sz_res) *sz_res = 6;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 3;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_jacobian_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 10*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 6*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 3*sizeof(casadi_real);
 return 0;
}

/* hostile_model_start_directional:(i0,i1,i2,i3)->(o0) */
static int casadi_f8(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real w0;
 /* #0: @0 = input[2][0] */
 w0 = arg[2] ? arg[2][0] : 0;
 /* #1: output[0][0] = @0 */
 if (res[0]) res[0][0] = w0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_start_directional(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
 return casadi_f8(arg, res, iw, w, mem);
}

CASADI_SYMBOL_EXPORT int hostile_model_start_directional_checkout(void) {
 return 0;
}

CASADI_SYMBOL_EXPORT void hostile_model_start_directional_release(int mem) {
}

CASADI_SYMBOL_EXPORT void hostile_model_start_directional_incref(void) {
}

CASADI_SYMBOL_EXPORT void hostile_model_start_directional_decref(void) {
}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_start_directional_n_in(void) { return 4;}

CASADI_SYMBOL_EXPORT casadi_int hostile_model_start_directional_n_out(void) { return 1;}

CASADI_SYMBOL_EXPORT casadi_real hostile_model_start_directional_default_in(casadi_int i) {
 switch (i) {
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_start_directional_name_in(casadi_int i) {
 switch (i) {
  case 0: return "i0";
  case 1: return "i1";
  case 2: return "i2";
  case 3: return "i3";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const char* hostile_model_start_directional_name_out(casadi_int i) {
 switch (i) {
  case 0: return "o0";
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_start_directional_sparsity_in(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  case 1: return casadi_s0;
  case 2: return casadi_s0;
  case 3: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT const casadi_int* hostile_model_start_directional_sparsity_out(casadi_int i) {
 switch (i) {
  case 0: return casadi_s0;
  default: return 0;
 }
}

CASADI_SYMBOL_EXPORT int hostile_model_start_directional_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 4;
 if (sz_res) *sz_res = 2;
 if (sz_iw) *sz_iw = 0;
 if (sz_w) *sz_w = 0;
 return 0;
}

CASADI_SYMBOL_EXPORT int hostile_model_start_directional_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
 if (sz_arg) *sz_arg = 4*sizeof(const casadi_real*);
 if (sz_res) *sz_res = 2*sizeof(casadi_real*);
 if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
 if (sz_w) *sz_w = 0*sizeof(casadi_real);
 return 0;
}


