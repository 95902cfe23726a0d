/*
 * Lets user-mode Linux 6.1 run on processors with AMX; loaded into its process by LD_PRELOAD.
 *
 * The guest kernel keeps 2.7 kB of extended registers of a process. With AMX a process has 11 kB, and ptrace(2) refuses
 * PTRACE_SETREGSET of less with EFAULT. The tiles at the end stay unused: no process of the guest can ask for them.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

/* Place of XSTATE_BV, which tells the components in use, and the two components of AMX: Intel SDM volume 1, 13.4, 13.5. */
enum { XSTATE_BV_AT = 512, HEADER_END = 576 };
static const uint64_t AMX = 3ull << 17;

long ptrace(enum __ptrace_request request, ...)
{
    /* Not on the stack: those of the guest kernel have 16 kB. It has one thread. */
    static uint8_t all[1 << 16];
    static long (*next)(enum __ptrace_request, ...);
    va_list arguments;

    if (!next)
        next = (long (*)(enum __ptrace_request, ...))dlsym(RTLD_NEXT, "ptrace");
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE) {
        struct iovec whole = {all, sizeof all};
        const struct iovec *given = data;
        if (!next(PTRACE_GETREGSET, pid, address, &whole) && given->iov_len >= HEADER_END && given->iov_len < whole.iov_len) {
            uint64_t used;
            memcpy(all, given->iov_base, given->iov_len);
            memcpy(&used, all + XSTATE_BV_AT, sizeof used);
            used &= ~AMX;
            memcpy(all + XSTATE_BV_AT, &used, sizeof used);
            return next(request, pid, address, &whole);
        }
    }
    return next(request, pid, address, data);
}
