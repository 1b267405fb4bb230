/* Lets 250 bodies stick at once in a thread whose stack has 384 kB, a little less than on macOS.
 *
 *     v_i' = load_i - sign(v_i): the friction of a body at rest is its load
 */
#include <assert.h>
#include <pthread.h>
#include <stdio.h>

#define NX 250
#define NZ 0
#define NU NX
#define MODES NX
#define EVENTS 0
#define ASSIGNED 0
#define DEFECTS 0
#define BOUNDED 0
#define ENCLOSED 0
#include "happen.h"

static double load(int i) {
    return (i - NX / 2) / (double)NX;
}

static bool see(void *owner, const Point *at, Seen *found) {
    (void)owner;
    memset(found, 0, sizeof *found);
    for (int i = 0; i < MODES; i++) {
        found->arguments[i] = at->x[i];
        found->rates[i] = found->slopes[i] = load(i) - at->u[i];
        found->sizes[i] = 1;
    }
    return true;
}

static bool decide_nothing(void *owner, const Point *at, Decision *found) {
    (void)owner, (void)at, (void)found;
    return true;
}

static bool spread(void *owner, const Point *at, Spread *found) {
    (void)owner, (void)at;
    for (int i = 0; i < MODES; i++) found->sized[i] = found->least[i] = found->rates[i] = 1;
    return true;
}

static void *slide(void *unused) {
    static double room[MODES * MODES];
    static Relation relations[MODES];
    static Switching switching;
    double x[NX] = {0}, u[NU];
    const Laws laws = {.relations = relations,
                       .room = room,
                       .see = see,
                       .decide = decide_nothing,
                       .spread = spread};
    const Point at = {0, x, NULL, u};
    for (int i = 0; i < MODES; i++) {
        relations[i].in_laws = true;
        switching.state[i] = SLIDES;
        u[i] = 1;
    }
    const bool decided[MODES + 1] = {0};
    bool zero[MODES + 1] = {0};
    assert(settle(&laws, &switching, &at, zero, decided, NULL).reason == GOES_ON);
    for (int i = 0; i < MODES; i++) assert(fabs(u[i] - load(i)) < 1e-15);
    return unused;
}

int main(void) {
    pthread_attr_t small;
    pthread_t thread;
    pthread_attr_init(&small);
    pthread_attr_setstacksize(&small, 384 * 1024);
    assert(pthread_create(&thread, &small, slide, NULL) == 0);
    pthread_join(thread, NULL);
    puts("all right");
    return 0;
}
