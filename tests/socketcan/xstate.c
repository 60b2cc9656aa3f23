/* Preloaded into user-mode Linux 6.1 on processors with AMX: its buffer of a process's extended registers ends before AMX's
 * tiles, and hosts since Linux 5.14 refuse to set a part of these registers (EFAULT). Here what it sets is laid over what
 * the process has. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define PTRACE_GETREGSET 0x4204L
#define PTRACE_SETREGSET 0x4205L
#define NT_X86_XSTATE 0x202L

static char whole[1 << 14];

long ptrace(long request, long pid, void *address, void *data)
{
	static long (*next)(long, long, void *, void *);

	if ((request & 0xffffffff) == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
		struct iovec *part = data, all = {whole, sizeof whole};

		if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &all) == 0 && part->iov_len < all.iov_len) {
			memcpy(whole, part->iov_base, part->iov_len);
			return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, address, &all);
		}
	}
	if (!next)
		next = dlsym(RTLD_NEXT, "ptrace");
	return next(request, pid, address, data);
}
