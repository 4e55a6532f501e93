/* Faults in the writes and syncs of a program, for files below one folder; loaded by LD_PRELOAD.
 *
 * FAULT_FOLDER   only files below this folder are affected
 * FAULT_CALL     write, sync or truncate
 * FAULT_FIRST    number of the first call that is affected, from 0; each process counts its own
 * FAULT_COUNT    how many calls are affected
 * FAULT_EFFECT   ENOSPC or EIO: the call fails; short: one byte less than half is written;
 *                delay: the call takes FAULT_DELAY_MS longer
 * FAULT_SYNCED   a folder: each file is copied to it whenever it was synced
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum effect { NONE, FAIL, SHORT };

static atomic_long calls;

static long number(const char *name) {
    const char *text = getenv(name);
    return text ? atol(text) : 0;
}

static int is_below_folder(int descriptor) {
    char link[64], path[PATH_MAX + 1];
    const char *folder = getenv("FAULT_FOLDER");
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, PATH_MAX);
    if (!folder || length < 0)
        return 0;
    path[length] = 0;
    return strncmp(path, folder, strlen(folder)) == 0;
}

static enum effect effect_on(int descriptor, const char *call) {
    const char *wanted = getenv("FAULT_CALL"), *effect = getenv("FAULT_EFFECT");
    if (!wanted || !effect || strcmp(wanted, call) || !is_below_folder(descriptor))
        return NONE;
    long since = atomic_fetch_add(&calls, 1) - number("FAULT_FIRST");
    if (since < 0 || since >= number("FAULT_COUNT"))
        return NONE;
    if (!strcmp(effect, "delay")) {
        usleep(1000 * number("FAULT_DELAY_MS"));
        return NONE;
    }
    if (!strcmp(effect, "short"))
        return SHORT;
    errno = strcmp(effect, "EIO") ? ENOSPC : EIO;
    return FAIL;
}

/* The library's own function of that name. */
#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static size_t shortened(enum effect effect, size_t size) {
    return effect == SHORT && size > 1 ? (size - 1) / 2 + (size < 3) : size;
}

#define FAULTY(call, failure, ...)                        \
    enum effect effect = effect_on(descriptor, call);     \
    if (effect == FAIL)                                   \
        return failure;                                   \
    return __VA_ARGS__

ssize_t write(int descriptor, const void *data, size_t size) {
    FAULTY("write", -1, REAL(write)(descriptor, data, shortened(effect, size)));
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at) {
    FAULTY("write", -1, REAL(pwrite)(descriptor, data, shortened(effect, size), at));
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at) {
    FAULTY("write", -1, REAL(pwrite64)(descriptor, data, shortened(effect, size), at));
}

ssize_t writev(int descriptor, const struct iovec *parts, int count) {
    FAULTY("write", -1, REAL(writev)(descriptor, parts, effect == SHORT ? 1 : count));
}

/* Copies a file that was synced; the copy gets its name, the inode, when it is whole. */
static int kept(int result, int descriptor) {
    char link[64], part[PATH_MAX + 64], whole[PATH_MAX + 64], data[1 << 16];
    const char *folder = getenv("FAULT_SYNCED");
    struct stat status;
    ssize_t length;
    if (result || !folder || !is_below_folder(descriptor) || fstat(descriptor, &status) ||
        !S_ISREG(status.st_mode))
        return result;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    snprintf(whole, sizeof whole, "%s/%lu.mcap", folder, (unsigned long)status.st_ino);
    snprintf(part, sizeof part, "%s/%lu.part", folder, (unsigned long)status.st_ino);
    int source = open(link, O_RDONLY | O_CLOEXEC);
    int copy = open(part, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    while ((length = read(source, data, sizeof data)) > 0)
        if (write(copy, data, length) != length)
            abort();
    close(source);
    close(copy);
    rename(part, whole);
    return result;
}

int fsync(int descriptor) {
    FAULTY("sync", -1, kept(REAL(fsync)(descriptor), descriptor));
}

int fdatasync(int descriptor) {
    FAULTY("sync", -1, kept(REAL(fdatasync)(descriptor), descriptor));
}

int ftruncate(int descriptor, off_t size) {
    FAULTY("truncate", -1, REAL(ftruncate)(descriptor, size));
}

int ftruncate64(int descriptor, off64_t size) {
    FAULTY("truncate", -1, REAL(ftruncate64)(descriptor, size));
}
