/* Preloaded into a process: Mitsuba uses no newer instructions than ISA_LIMIT allows ("avx2", or "" for all of the CPU).
 *
 * Embree's devices take the limit as an option. Dr.Jit's LLVM backend then compiles for x86-64-v3, that is AVX2: its
 * least, since a fused operation that becomes a call is refused. Each device is recorded as a line of the file
 * ISA_LIMIT_LOG, so that a run in which none was made is noticed; ISA_LIMIT_VERBOSE=1 lets Embree print what it uses.
 *
 * Mitsuba puts Embree's functions into a C++ namespace, and Python loads the libraries into a scope of their own: the
 * functions have mangled names, and are looked up in their libraries instead of among "the next ones".
 */
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#define NEW_DEVICE "_ZN7mitsuba12rtcNewDeviceEPKc"
#define LLVM_WIDTH "_Z21jit_llvm_vector_widthv"
#define LLVM_SET_TARGET "_Z19jit_llvm_set_targetPKcS0_j"

typedef void *new_device(const char *config);
typedef unsigned llvm_width(void);
typedef void llvm_set_target(const char *cpu, const char *features, unsigned width);

static const char *setting(const char *name)
{
    const char *value = getenv(name);
    return value ? value : "";
}

static void stop(const char *problem)
{
    fprintf(stderr, "isa_limit: %s\n", problem);
    abort();
}

static void *function(const char *library, const char *name)
{
    void *loaded = dlopen(library, RTLD_LAZY | RTLD_NOLOAD);
    void *found = loaded ? dlsym(loaded, name) : NULL;
    if (!found) {
        fprintf(stderr, "isa_limit: %s has no %s\n", library, name);
        abort();
    }
    return found;
}

static void record(const char *config)
{
    char line[600];
    int length = snprintf(line, sizeof line, "%s\n", config);
    int file = open(setting("ISA_LIMIT_LOG"), O_WRONLY | O_APPEND);
    if (file < 0 || write(file, line, (size_t)length) != length)
        stop("the file ISA_LIMIT_LOG cannot be written");
    close(file);
}

static void limit_llvm(void)
{
    llvm_width *width = (llvm_width *)function("libdrjit-core.so", LLVM_WIDTH);
    if (width() > 8) /* 0 in a scalar variant */
        ((llvm_set_target *)function("libdrjit-core.so", LLVM_SET_TARGET))("x86-64-v3", "", 8);
}

void *limited_new_device(const char *config) __asm__(NEW_DEVICE);

void *limited_new_device(const char *config)
{
    char limited[512];
    int length = snprintf(limited, sizeof limited, "%s", config ? config : "");
    const char *isa = setting("ISA_LIMIT"), *verbose = setting("ISA_LIMIT_VERBOSE");
    if (*isa) {
        length += snprintf(limited + length, sizeof limited - (size_t)length, ",max_isa=%s", isa);
        limit_llvm();
    }
    if (*verbose)
        length += snprintf(limited + length, sizeof limited - (size_t)length, ",verbose=%s", verbose);
    if (length >= (int)sizeof limited)
        stop("the configuration is too long");
    record(limited);
    return ((new_device *)function("libembree3.so", NEW_DEVICE))(limited);
}
