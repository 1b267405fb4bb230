/* A crew whose threads use 4 MB of their stacks each. */
#include "crew.h"

#include <stdio.h>
#include <string.h>

enum { MEMBERS = 3, TAKEN = 4 << 20 };

static void take_stack(int *member) {
    volatile char taken[TAKEN];
    for (size_t i = 0; i < sizeof taken; i += 1024) taken[i] = 1;
    *member += taken[0];
}

static void task(void *member) {
    if (*(int *)member > 0) take_stack(member); /* 0: the caller's own, which takes little */
}

int main(void) {
    int members[MEMBERS] = {0, 1, 2};
    Crew crew = {task, (char *)members, sizeof *members, MEMBERS, 0, NULL};
    crew_start(&crew);
    crew_work(&crew);
    crew_end(&crew);
    printf("%lld %d %d\n", crew.started, members[1], members[2]);
    return 0;
}
