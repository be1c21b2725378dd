// SPDX-License-Identifier: Apache-2.0
// Makes I/O calls on the files below one directory fail. The tests load it by LD_PRELOAD.
//
// Without FAILING_IO in the environment, no call changes. FAILING_IO is "FIRST LAST ERROR INSTEAD
// COUNTER LOG DIRECTORY": calls are numbered from 1 on, over all processes that share the file
// COUNTER (8 bytes). The calls FIRST to LAST fail with the error number ERROR where a file system
// or the system can return it, and otherwise with INSTEAD; 0 is no error, and SHORT lets a write store
// half of its bytes. Each call is a line "NUMBER CALL PATH CAN ERROR" in LOG: CAN is
// 1 if ERROR can be the result of this call, and the last field is the error that it had.

#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#define SHORT (-1)
#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

enum kind { READS = 1, OPENS = 2, CHANGES = 4, GROWS = 8, WRITES = 16 };

static struct {
    long first, last;
    int error, instead;
    char counter[4096], log[4096], directory[4096];
} faults;
static long *calls;

static int configured(void)
{
    if (calls)
        return 1;
    const char *text = getenv("FAILING_IO");
    if (!text || sscanf(text, "%ld %ld %d %d %4095s %4095s %4095s", &faults.first, &faults.last,
                        &faults.error, &faults.instead, faults.counter, faults.log,
                        faults.directory) != 7)
        return 0;
    int fd = syscall(SYS_openat, AT_FDCWD, faults.counter, O_RDWR | O_CLOEXEC);
    void *map = mmap(NULL, sizeof *calls, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    syscall(SYS_close, fd);
    if (map == MAP_FAILED)
        abort();
    calls = map;
    return 1;
}

static int can_be(int error, int kind)
{
    switch (error) {
    case 0:
        return 1;
    case ENOSPC:
    case EDQUOT:
        return !!(kind & GROWS);
    case EMFILE:
        return !!(kind & OPENS);
    case EROFS:
        return !!(kind & CHANGES);
    case SHORT:
        return !!(kind & WRITES);
    default:
        return 1;
    }
}

// Return the error of a call on `path`, below directory `at` if it is relative.
static int fault(const char *call, int at, const char *path, int kind)
{
    char whole[8192] = "", link[64];
    if (!path || !configured())
        return 0;
    if (path[0] != '/') {
        snprintf(link, sizeof link, at == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at);
        ssize_t length = readlink(link, whole, 4095);
        if (length < 0)
            return 0;
        snprintf(whole + length, sizeof whole - length, path[0] ? "/%s" : "%s", path);
    } else {
        snprintf(whole, sizeof whole, "%s", path);
    }
    size_t length = strlen(faults.directory);
    if (strncmp(whole, faults.directory, length) || (whole[length] && whole[length] != '/'))
        return 0;
    long number = __atomic_add_fetch(calls, 1, __ATOMIC_SEQ_CST);
    int can = can_be(faults.error, kind), error = 0;
    if (faults.first <= number && number <= faults.last)
        error = can ? faults.error : faults.instead;
    char line[16384];
    int size = snprintf(line, sizeof line, "%ld %s %s %d %d\n", number, call, whole, can, error);
    int fd = syscall(SYS_openat, AT_FDCWD, faults.log, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
    syscall(SYS_write, fd, line, size);
    syscall(SYS_close, fd);
    return error;
}

static int fault_at(const char *call, int fd, int kind)
{
    char link[64], path[4096];
    if (!configured())
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 1 || path[0] != '/')
        return 0;
    path[length] = 0;
    char *removed = strstr(path, " (deleted)");
    if (removed)
        *removed = 0;
    return fault(call, AT_FDCWD, path, kind);
}

#define FAIL_IF(expression, result) \
    do {                            \
        int failure = (expression); \
        if (failure) {              \
            errno = failure;        \
            return (result);        \
        }                           \
    } while (0)

static int kind_of_open(int at, const char *path, int flags)
{
    int kind = OPENS;
    if ((flags & O_CREAT) && syscall(SYS_faccessat, at, path, F_OK))
        kind |= GROWS;
    return (flags & O_ACCMODE) == O_RDONLY ? kind : kind | CHANGES;
}

#define OPEN(name)                                                                     \
    int name(const char *path, int flags, ...)                                         \
    {                                                                                  \
        va_list more;                                                                  \
        va_start(more, flags);                                                         \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0;        \
        va_end(more);                                                                  \
        FAIL_IF(fault("open", AT_FDCWD, path, kind_of_open(AT_FDCWD, path, flags)), -1); \
        return NEXT(name)(path, flags, mode);                                          \
    }
#define OPENAT(name)                                                            \
    int name(int at, const char *path, int flags, ...)                          \
    {                                                                           \
        va_list more;                                                           \
        va_start(more, flags);                                                  \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                           \
        FAIL_IF(fault("open", at, path, kind_of_open(at, path, flags)), -1);    \
        return NEXT(name)(at, path, flags, mode);                               \
    }
OPEN(open)
OPEN(open64)
OPENAT(openat)
OPENAT(openat64)

DIR *opendir(const char *path)
{
    FAIL_IF(fault("opendir", AT_FDCWD, path, OPENS), NULL);
    return NEXT(opendir)(path);
}

// Fail a write of `size` bytes, or shorten it.
#define FAIL_WRITE                                              \
    int error = fault_at("write", fd, CHANGES | GROWS | WRITES); \
    if (error == SHORT)                                         \
        size = size > 1 ? size / 2 : size;                      \
    else                                                        \
        FAIL_IF(error, -1);

#define PWRITE(name, offset_type)                                           \
    ssize_t name(int fd, const void *data, size_t size, offset_type offset) \
    {                                                                       \
        FAIL_WRITE                                                          \
        return NEXT(name)(fd, data, size, offset);                          \
    }
#define PREAD(name, offset_type)                                      \
    ssize_t name(int fd, void *data, size_t size, offset_type offset) \
    {                                                                 \
        FAIL_IF(fault_at("read", fd, READS), -1);                     \
        return NEXT(name)(fd, data, size, offset);                    \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)
PREAD(pread, off_t)
PREAD(pread64, off64_t)

ssize_t write(int fd, const void *data, size_t size)
{
    FAIL_WRITE
    return NEXT(write)(fd, data, size);
}

ssize_t read(int fd, void *data, size_t size)
{
    FAIL_IF(fault_at("read", fd, READS), -1);
    return NEXT(read)(fd, data, size);
}

// A file system may report a failed write no earlier than when the file is closed.
int close(int fd)
{
    int writable = configured() && (fcntl(fd, F_GETFL) & O_ACCMODE) != O_RDONLY;
    int error = writable ? fault_at("close", fd, CHANGES | GROWS) : 0;
    int result = NEXT(close)(fd);
    FAIL_IF(error, -1);
    return result;
}

#define ON_FILE(name, call, kind, parameters, ...) \
    int name parameters                            \
    {                                              \
        FAIL_IF(fault_at(call, fd, kind), -1);     \
        return NEXT(name)(__VA_ARGS__);            \
    }
ON_FILE(fsync, "fsync", CHANGES | GROWS, (int fd), fd)
ON_FILE(fdatasync, "fsync", CHANGES | GROWS, (int fd), fd)
ON_FILE(ftruncate, "ftruncate", CHANGES, (int fd, off_t size), fd, size)
ON_FILE(ftruncate64, "ftruncate", CHANGES, (int fd, off64_t size), fd, size)
ON_FILE(fstat, "fstat", READS, (int fd, struct stat *status), fd, status)
ON_FILE(fstat64, "fstat", READS, (int fd, struct stat64 *status), fd, status)

// These return their error instead of setting errno.
int posix_fallocate(int fd, off_t offset, off_t size)
{
    int error = fault_at("fallocate", fd, CHANGES | GROWS);
    return error ? error : NEXT(posix_fallocate)(fd, offset, size);
}

int posix_fallocate64(int fd, off64_t offset, off64_t size)
{
    int error = fault_at("fallocate", fd, CHANGES | GROWS);
    return error ? error : NEXT(posix_fallocate64)(fd, offset, size);
}

#define ON_PATH(name, call, kind, parameters, at, path, ...) \
    int name parameters                                      \
    {                                                        \
        FAIL_IF(fault(call, at, path, kind), -1);            \
        return NEXT(name)(__VA_ARGS__);                      \
    }
ON_PATH(stat, "stat", READS, (const char *path, struct stat *status), AT_FDCWD, path, path, status)
ON_PATH(stat64, "stat", READS, (const char *path, struct stat64 *status), AT_FDCWD, path, path, status)
ON_PATH(fstatat, "stat", READS, (int at, const char *path, struct stat *status, int flags), at, path,
        at, path, status, flags)
ON_PATH(fstatat64, "stat", READS, (int at, const char *path, struct stat64 *status, int flags), at, path,
        at, path, status, flags)
ON_PATH(lstat, "stat", READS, (const char *path, struct stat *status), AT_FDCWD, path, path, status)
ON_PATH(lstat64, "stat", READS, (const char *path, struct stat64 *status), AT_FDCWD, path, path, status)
ON_PATH(unlink, "unlink", CHANGES, (const char *path), AT_FDCWD, path, path)
ON_PATH(unlinkat, "unlink", CHANGES, (int at, const char *path, int flags), at, path, at, path, flags)
ON_PATH(rmdir, "rmdir", CHANGES, (const char *path), AT_FDCWD, path, path)
ON_PATH(mkdir, "mkdir", CHANGES | GROWS, (const char *path, mode_t mode), AT_FDCWD, path, path, mode)
ON_PATH(rename, "rename", CHANGES, (const char *path, const char *to), AT_FDCWD, path, path, to)
ON_PATH(link, "link", CHANGES | GROWS, (const char *path, const char *to), AT_FDCWD, path, path, to)
ON_PATH(linkat, "link", CHANGES | GROWS,
        (int at, const char *path, int at2, const char *to, int flags), at, path, at, path, at2, to, flags)
