/* Lets the n-th change of a file below a folder fail, or ends the process in it. Loaded before the C library.
 *
 * FAILING_UNDER is the folder; FAILING_AT counts from 1, 0 counts only; FAILING_HOW is kill (half of a write is done
 * first), full (ENOSPC for this and every later call that takes room) or broken (EIO once); FAILING_RANK is the MPI rank
 * that it is about; FAILING_LOG gets a line for each call. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static char under[PATH_MAX], how[16];
static long at = -1, count = 0;
static int full = 0, log_fd = -1;

void failing_writes(const char *folder, long n, const char *kind, int log_to) {
    snprintf(under, sizeof under, "%s", folder);
    snprintf(how, sizeof how, "%s", kind);
    count = 0, full = 0, at = n, log_fd = log_to;
}

__attribute__((constructor)) static void begin(void) {
    const char *folder = getenv("FAILING_UNDER"), *n = getenv("FAILING_AT"), *kind = getenv("FAILING_HOW");
    const char *wanted = getenv("FAILING_RANK"), *rank = getenv("OMPI_COMM_WORLD_RANK"), *log = getenv("FAILING_LOG");
    if (!folder || !n || !kind || (rank && wanted && strcmp(rank, wanted))) return;
    if (!rank && wanted) return; /* mpirun itself */
    failing_writes(folder, atol(n), kind, log ? open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666) : -1);
}

static int below(const char *path) { return at >= 0 && path && !strncmp(path, under, strlen(under)); }

static int fd_below(int fd) {
    char link[64], path[PATH_MAX];
    if (at < 0 || fd < 3) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    return below(path);
}

static void die(void) {
    kill(getpid(), SIGKILL);
    for (;;) pause();
}

/* Returns the error that the call shall have, 0 for none, -1 where the process shall end. */
static int verdict(const char *name, int takes_room) {
    count++;
    if (log_fd >= 0) dprintf(log_fd, "%ld %s\n", count, name);
    if (full && takes_room) return ENOSPC;
    if (at == 0 || count != at) return 0;
    if (!strcmp(how, "kill")) return -1;
    if (!strcmp(how, "broken")) return EIO;
    full = 1;
    return takes_room ? ENOSPC : 0;
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

#define FAIL(name, room, on_kill, value_of_error) \
    int error = verdict(name, room); \
    if (error < 0) { on_kill; die(); } \
    if (error > 0) { errno = error; return value_of_error; }

ssize_t write(int fd, const void *data, size_t n) {
    REAL(ssize_t, "write", int, const void *, size_t);
    if (fd != log_fd && fd_below(fd)) { FAIL("write", 1, real(fd, data, n / 2), -1) }
    return real(fd, data, n);
}

#define PWRITE(symbol, off) \
    ssize_t symbol(int fd, const void *data, size_t n, off offset) { \
        REAL(ssize_t, #symbol, int, const void *, size_t, off); \
        if (fd_below(fd)) { FAIL("pwrite", 1, real(fd, data, n / 2, offset), -1) } \
        return real(fd, data, n, offset); \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define TRUNCATE(symbol, off) \
    int symbol(int fd, off n) { \
        REAL(int, #symbol, int, off); \
        if (fd_below(fd)) { FAIL("ftruncate", 0, , -1) } \
        return real(fd, n); \
    }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

#define ALLOCATE(symbol, off) \
    int symbol(int fd, off from, off n) { \
        REAL(int, #symbol, int, off, off); \
        if (fd_below(fd)) { \
            int error = verdict("posix_fallocate", 1); \
            if (error < 0) die(); \
            if (error > 0) return error; \
        } \
        return real(fd, from, n); \
    }
ALLOCATE(posix_fallocate, off_t)
ALLOCATE(posix_fallocate64, off64_t)

int fsync(int fd) {
    REAL(int, "fsync", int);
    if (fd_below(fd)) { FAIL("fsync", 0, , -1) }
    return real(fd);
}

ssize_t sendfile64(int to, int from, off64_t *offset, size_t n) {
    REAL(ssize_t, "sendfile64", int, int, off64_t *, size_t);
    if (fd_below(to)) { FAIL("sendfile", 1, real(to, from, offset, n / 2), -1) }
    return real(to, from, offset, n);
}

ssize_t sendfile(int to, int from, off_t *offset, size_t n) {
    REAL(ssize_t, "sendfile", int, int, off_t *, size_t);
    if (fd_below(to)) { FAIL("sendfile", 1, real(to, from, offset, n / 2), -1) }
    return real(to, from, offset, n);
}

int rename(const char *from, const char *to) {
    REAL(int, "rename", const char *, const char *);
    if (below(to)) { FAIL("rename", 0, , -1) }
    return real(from, to);
}

int renameat(int a, const char *from, int b, const char *to) {
    REAL(int, "renameat", int, const char *, int, const char *);
    if (below(to)) { FAIL("rename", 0, , -1) }
    return real(a, from, b, to);
}

int linkat(int a, const char *from, int b, const char *to, int flags) {
    REAL(int, "linkat", int, const char *, int, const char *, int);
    if (below(to)) { FAIL("link", 1, , -1) }
    return real(a, from, b, to, flags);
}

int unlink(const char *path) {
    REAL(int, "unlink", const char *);
    if (below(path) && access(path, F_OK) == 0) { FAIL("unlink", 0, , -1) }
    return real(path);
}

int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    if (below(path)) { FAIL("mkdir", 1, , -1) }
    return real(path, mode);
}
