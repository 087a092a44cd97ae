/* Preloaded into one rank: cosines and sines are not numbers any more once the file BREAK names is there. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <unistd.h>

static int is_broken(void)
{
    static atomic_int broken;
    static atomic_uint calls;
    if (!broken && atomic_fetch_add(&calls, 1) % 64 == 0)
        broken = access(getenv("BREAK"), F_OK) == 0;
    return broken;
}

double cos(double angle)
{
    double (*real)(double) = (double (*)(double))dlsym(RTLD_NEXT, "cos");
    return is_broken() ? NAN : real(angle);
}

double sin(double angle)
{
    double (*real)(double) = (double (*)(double))dlsym(RTLD_NEXT, "sin");
    return is_broken() ? NAN : real(angle);
}

void sincos(double angle, double *sine, double *cosine)
{
    *sine = sin(angle);
    *cosine = cos(angle);
}
