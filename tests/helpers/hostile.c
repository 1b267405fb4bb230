/* What the FMUs of hostile.py do; see there. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
static char bad_function[80], bad_action[80];
static double bad_number;
/* The path of a URI, whose spaces and letters beyond ASCII are percent-encoded. */
static void decode(const char *uri, char *path, size_t size) {
    for (unsigned byte; *uri && size > 1; uri++, size--) {
        if (*uri == '%' && sscanf(uri + 1, "%2x", &byte) == 1) *path++ = (char)byte, uri += 2;
        else *path++ = *uri;
    }
    *path = 0;
}
void choose_fault(const char *place) {
    char folder[4000], path[4096];
    const char *begin = strstr(place ? place : "", "/");
    while (begin && begin[1] == '/') begin++;
    decode(begin ? begin : "", folder, sizeof folder);
    snprintf(path, sizeof path, "%s/fault.txt", folder);
    FILE *file = fopen(path, "r");
    if (!file) return;
    if (fscanf(file, "%79s %79s %lf", bad_function, bad_action, &bad_number) < 2)
        bad_function[0] = 0;
    fclose(file);
}
static int is(const char *name) { return !strcmp(bad_action, name); }
int fault(const char *function) {
    if (strcmp(function, bad_function)) return 0;
    if (is("status")) return 1;
    if (is("abort")) abort();
    if (is("exit")) exit((int)bad_number);
    if (is("_exit")) _exit((int)bad_number);
    if (is("raise")) raise((int)bad_number);
    if (is("segv")) *(volatile int *)8 = 1;
    if (is("hang")) for (volatile int i = 0;; i = 1) {}
    if (is("sleep")) for (;;) sleep(60);
    if (is("deaf")) { signal(SIGTERM, SIG_IGN); signal(SIGINT, SIG_IGN); for (;;) sleep(60); }
    if (is("print")) for (int i = 0; i < bad_number; i++) puts("here I am");
    if (is("escape")) puts("\033[2Jcleared\007 \033]0;title\007");
    if (is("child") && !fork()) for (;;) sleep(60);
    if (is("daemon") && !fork()) {
        setsid();
        if (!fork()) {
            for (int i = 0; i < 64; i++) close(i);
            for (;;) sleep(60);
        }
        _exit(0);
    }
    if (is("memory")) for (;;) { char *p = malloc(1 << 26); if (!p) abort(); memset(p, 1, 1 << 26); }
    if (is("disk")) { FILE *f = fopen("big", "w"); char b[65536] = {1}; for (;;) fwrite(b, 1, sizeof b, f), fflush(f); }
    if (is("files")) { int n = 0; while (open("/dev/null", O_RDONLY) >= 0) n++; if (n < 300) abort(); }
    if (is("close")) for (int i = 0; i < 64; i++) close(i);
    if (is("leave")) { chdir("/"); }
    if (is("litter")) { mkdir("litter", 0700); fclose(fopen("litter/file", "w")); }
    return 0;
}
int fault_status(void) { return (int)bad_number; }
