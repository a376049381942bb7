/* Stands before the C library and before numpy's BLAS and LAPACK: changes the last bit of what they return.

   cc -O1 -shared -fPIC -o other_libraries.so other_libraries.c -ldl, then LD_PRELOAD. Zero, infinity and nan stay. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <link.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

static int is_blas(struct dl_phdr_info *info, size_t size, void *path) {
    (void)size;
    if (!strstr(info->dlpi_name, "openblas64")) return 0;
    *(const char **)path = info->dlpi_name;
    return 1;
}

/* numpy loads its BLAS for itself: it is not among the next libraries. */
static void *next_symbol(const char *name) {
    const char *path = 0;
    if (strncmp(name, "scipy_", 6) != 0) return dlsym(RTLD_NEXT, name);
    dl_iterate_phdr(is_blas, &path);
    return dlsym(dlopen(path, RTLD_LAZY | RTLD_NOLOAD), name);
}

static double changed(double x) {
    uint64_t bits;
    if (x == 0.0 || !isfinite(x)) return x;
    memcpy(&bits, &x, sizeof bits);
    bits ^= 1u;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static void change(double *x, int64_t count, int64_t step) {
    for (int64_t i = 0; i < count; i++) x[i * step] = changed(x[i * step]);
}

static void change_matrix(double *a, int64_t rows, int64_t columns, int64_t row_length) {
    for (int64_t i = 0; i < rows; i++) change(a + i * row_length, columns, 1);
}

#define ONE(NAME)                                                             \
    double NAME(double x) {                                                   \
        static double (*real)(double);                                        \
        if (!real) real = (double (*)(double))next_symbol(#NAME);             \
        return changed(real(x));                                              \
    }
#define TWO(NAME)                                                             \
    double NAME(double x, double y) {                                         \
        static double (*real)(double, double);                                \
        if (!real) real = (double (*)(double, double))next_symbol(#NAME);     \
        return changed(real(x, y));                                           \
    }

ONE(sin) ONE(cos) ONE(tan) ONE(asin) ONE(acos) ONE(atan) ONE(sinh) ONE(cosh) ONE(tanh)
ONE(asinh) ONE(acosh) ONE(atanh) ONE(exp) ONE(exp2) ONE(expm1) ONE(log) ONE(log2) ONE(log10) ONE(log1p)
ONE(cbrt) ONE(erf) ONE(erfc) ONE(lgamma) ONE(tgamma)
TWO(atan2) TWO(pow) TWO(hypot)

void sincos(double x, double *s, double *c) { *s = sin(x); *c = cos(x); }

typedef int64_t n_t;

double scipy_cblas_ddot64_(n_t n, const double *x, n_t step_x, const double *y, n_t step_y) {
    double (*real)(n_t, const double *, n_t, const double *, n_t) = next_symbol("scipy_cblas_ddot64_");
    return changed(real(n, x, step_x, y, step_y));
}

void scipy_cblas_dgemv64_(int order, int transposed, n_t m, n_t n, double alpha, const double *a, n_t lda,
                          const double *x, n_t step_x, double beta, double *y, n_t step_y) {
    void (*real)(int, int, n_t, n_t, double, const double *, n_t, const double *, n_t, double, double *, n_t) =
        next_symbol("scipy_cblas_dgemv64_");
    real(order, transposed, m, n, alpha, a, lda, x, step_x, beta, y, step_y);
    change(y, transposed == 111 ? m : n, step_y);
}

void scipy_cblas_dgemm64_(int order, int of_a, int of_b, n_t m, n_t n, n_t k, double alpha, const double *a, n_t lda,
                          const double *b, n_t ldb, double beta, double *c, n_t ldc) {
    void (*real)(int, int, int, n_t, n_t, n_t, double, const double *, n_t, const double *, n_t, double, double *, n_t) =
        next_symbol("scipy_cblas_dgemm64_");
    real(order, of_a, of_b, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc);
    if (order == 101) change_matrix(c, m, n, ldc);
    else change_matrix(c, n, m, ldc);
}

void scipy_cblas_dsyrk64_(int order, int upper, int transposed, n_t n, n_t k, double alpha, const double *a, n_t lda,
                          double beta, double *c, n_t ldc) {
    void (*real)(int, int, int, n_t, n_t, double, const double *, n_t, double, double *, n_t) =
        next_symbol("scipy_cblas_dsyrk64_");
    real(order, upper, transposed, n, k, alpha, a, lda, beta, c, ldc);
    change_matrix(c, n, n, ldc);
}

void scipy_dgesv_64_(n_t *n, n_t *columns, double *a, n_t *lda, n_t *pivots, double *b, n_t *ldb, n_t *info) {
    void (*real)(n_t *, n_t *, double *, n_t *, n_t *, double *, n_t *, n_t *) = next_symbol("scipy_dgesv_64_");
    real(n, columns, a, lda, pivots, b, ldb, info);
    change_matrix(b, *columns, *n, *ldb);
}

void scipy_dgetrf_64_(n_t *m, n_t *n, double *a, n_t *lda, n_t *pivots, n_t *info) {
    void (*real)(n_t *, n_t *, double *, n_t *, n_t *, n_t *) = next_symbol("scipy_dgetrf_64_");
    real(m, n, a, lda, pivots, info);
    change_matrix(a, *n, *m, *lda);
}

void scipy_dpotrf_64_(char *upper, n_t *n, double *a, n_t *lda, n_t *info) {
    void (*real)(char *, n_t *, double *, n_t *, n_t *) = next_symbol("scipy_dpotrf_64_");
    real(upper, n, a, lda, info);
    change_matrix(a, *n, *n, *lda);
}

void scipy_dsyevd_64_(char *vectors, char *upper, n_t *n, double *a, n_t *lda, double *values, double *work,
                      n_t *length, n_t *whole, n_t *whole_length, n_t *info) {
    void (*real)(char *, char *, n_t *, double *, n_t *, double *, double *, n_t *, n_t *, n_t *, n_t *) =
        next_symbol("scipy_dsyevd_64_");
    real(vectors, upper, n, a, lda, values, work, length, whole, whole_length, info);
    if (*length > 0) change(values, *n, 1);
}

void scipy_dgesdd_64_(char *job, n_t *m, n_t *n, double *a, n_t *lda, double *s, double *u, n_t *ldu, double *vt,
                      n_t *ldvt, double *work, n_t *length, n_t *whole, n_t *info) {
    void (*real)(char *, n_t *, n_t *, double *, n_t *, double *, double *, n_t *, double *, n_t *, double *, n_t *,
                 n_t *, n_t *) = next_symbol("scipy_dgesdd_64_");
    real(job, m, n, a, lda, s, u, ldu, vt, ldvt, work, length, whole, info);
    if (*length > 0) change(s, *m < *n ? *m : *n, 1);
}

void scipy_dgelsd_64_(n_t *m, n_t *n, n_t *columns, double *a, n_t *lda, double *b, n_t *ldb, double *s, double *rcond,
                      n_t *rank, double *work, n_t *length, n_t *whole, n_t *info) {
    void (*real)(n_t *, n_t *, n_t *, double *, n_t *, double *, n_t *, double *, double *, n_t *, double *, n_t *,
                 n_t *, n_t *) = next_symbol("scipy_dgelsd_64_");
    real(m, n, columns, a, lda, b, ldb, s, rcond, rank, work, length, whole, info);
    if (*length > 0) change_matrix(b, *columns, *n, *ldb);
}
