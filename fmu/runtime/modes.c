/* Modes of relations: which ones are consistent at an instant.

   The mode of a relation whose argument is 0 is that of the first time derivative that is not. If
   neither mode is consistent, the relation slides: its argument stays 0, and its mode is between
   -1 and 1.

   Source  Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer 1988. */
#include "modes.h"

#include <math.h>
#include <string.h>

#include "equations.h"
#include "input_motion.h"
#include "logging.h"

#if HAS_EVENTS

static const double EDGE = 1e-9;        /* by which the mode of a new sliding may leave -1 ... 1 */
static const double LEAVING = 1e-12;    /* by which a mode leaves it before that is an event */
static const double NOT_AFFINE = 1e-8;  /* rate of an argument that should stay, relative */
static const double MOVED = 1e8;        /* roundings by which only an input moves an argument */
static const double NO_BOUNDARY = 1e30; /* far from any: of time alone, or without a value */

static Point present(Instance *self) {
    double *values = self->state.values;
    return (Point){values[TIME], values + FIRST_STATE, values + FIRST_ALGEBRAIC,
                   values + FIRST_INPUT};
}

static void pass(Instance *self, const Point *at) {
    self->arg[0] = &at->t;
    self->arg[1] = at->x;
    self->arg[2] = at->z;
    self->arg[3] = at->u;
    self->arg[4] = self->state.values + FIRST_PARAMETER;
}

/* The algebraic unknowns from their guess; relations at what is solved. False: without a value. */
static bool see(Instance *self, const Point *at, Seen *seen) {
    double z[ROOM(NZ)] = {0};
    pass(self, at);
    if (NZ > 0) {
        self->res[0] = z;
        if (model_algebraic(self->arg, self->res, self->iw, self->w, 0)) return false;
        for (int i = 0; i < NZ; i++)
            if (!isfinite(z[i])) return false;
        memcpy(at->z, z, NZ * sizeof *z);
    }
    double slopes[ROOM(NU)] = {0};
    input_slopes_at(self, at->t, slopes);
    self->arg[5] = slopes;
    self->res[0] = seen->arguments;
    self->res[1] = seen->rates;
    self->res[2] = seen->seconds;
    self->res[3] = seen->sizes;
    return !model_relations(self->arg, self->res, self->iw, self->w, 0);
}

typedef double Rows[ROOM(N_MODES)][ROOM(N_MODES) + 1];

/* Solve n linear equations, the right side being the last column; false if they are singular. */
static bool solve_linear(int n, Rows a) {
    for (int c = 0; c < n; c++) {
        int pivot = c;
        for (int r = c + 1; r < n; r++)
            if (fabs(a[r][c]) > fabs(a[pivot][c])) pivot = r;
        if (!(fabs(a[pivot][c]) > 0)) return false;
        for (int k = 0; k <= n; k++) {
            const double swapped = a[c][k];
            a[c][k] = a[pivot][k];
            a[pivot][k] = swapped;
        }
        for (int r = 0; r < n; r++) {
            if (r == c) continue;
            const double share = a[r][c] / a[c][c];
            for (int k = c; k <= n; k++) a[r][k] -= share * a[c][k];
        }
    }
    for (int r = 0; r < n; r++) a[r][n] /= a[r][r];
    return true;
}

/* The rates of the arguments are affine in the modes: modes 0 and 1 tell how. */
bool follow(Instance *self, const Point *at) {
    double *modes = at->u + NU - N_MODES;
    int which[ROOM(N_MODES)], n = 0;
    for (int i = 0; i < N_MODES; i++)
        if (self->state.switching.slides[i] > 0) which[n++] = i;
    if (n == 0) return true;

    Seen base, one;
    Rows a;
    double sizes[ROOM(N_MODES)];
    for (int k = 0; k < n; k++) modes[which[k]] = 0;
    if (!see(self, at, &base)) return false;
    for (int k = 0; k < n; k++) {
        a[k][n] = -base.rates[which[k]];
        sizes[k] = fabs(a[k][n]);
    }
    for (int c = 0; c < n; c++) {
        modes[which[c]] = 1;
        if (!see(self, at, &one)) return false;
        modes[which[c]] = 0;
        for (int r = 0; r < n; r++) {
            a[r][c] = one.rates[which[r]] - base.rates[which[r]];
            sizes[r] += fabs(a[r][c]);
        }
    }
    if (!solve_linear(n, a)) return false;
    for (int k = 0; k < n; k++) modes[which[k]] = a[k][n];
    if (!see(self, at, &one)) return false;
    for (int k = 0; k < n; k++)
        if (!(fabs(one.rates[which[k]]) <= NOT_AFFINE * sizes[k])) return false;
    return true;
}

Status follow_present(Instance *self) {
    const Point at = present(self);
    if (follow(self, &at)) return OK;
    return refuse(self, DISCARD, "no mode keeps an expression at 0 that slides there at time %.17g",
                  at.t);
}

bool is_sliding(const Instance *self) {
    for (int i = 0; i < N_MODES; i++)
        if (self->state.switching.slides[i] > 0) return true;
    return false;
}

Status watch_relations(Instance *self, Seen *seen) {
    const Status status = follow_present(self);
    const Point at = present(self);
    if (status != OK || see(self, &at, seen)) return status;
    return refuse(self, DISCARD, "the relations cannot be computed at time %.17g", at.t);
}

bool is_moved(const Instance *self, const Seen *seen, int i) {
    const Switching *s = &self->state.switching;
    const double way = fabs(seen->arguments[i] - s->offsets[i]);
    return relations[i].of_input && !(way <= MOVED * s->slack[i]);
}

bool is_held(const Instance *self, const Seen *seen, int i) {
    const double most = self->state.switching.stays[i];
    return most > 0 && fabs(seen->rates[i]) <= most && !is_moved(self, seen, i);
}

Status look_at_slides(Instance *self, Status severity) {
    Seen seen;
    const Status status = is_sliding(self) ? watch_relations(self, &seen) : OK;
    for (int i = 0; i < N_MODES && status == OK; i++)
        if (self->state.switching.slides[i] > 0 && is_moved(self, &seen, i))
            return refuse(self, severity,
                          "an input moves '%s', which stays 0, at %.12g s, and model exchange does "
                          "not tell its rate: use co-simulation, or compute it in the model",
                          relations[i].name, self->state.values[TIME]);
    return status;
}

/* How far arguments are within their modes, and the rates of that. */
void measure(const Instance *self, const double modes[], const Seen *seen, double inside[],
             double rates[]) {
    const Switching *s = &self->state.switching;
    for (int i = 0; i < N_MODES; i++) {
        const double mode = modes[i], value = seen->arguments[i] - s->offsets[i];
        double sign = mode;
        if (s->slides[i] > 0) {
            sign = 0;
            const bool jumped = self->state.interface == INTERFACE_CS && is_moved(self, seen, i);
            inside[i] = jumped ? -1 : 1 - fabs(mode) + LEAVING;
        } else if (relations[i].of_time || !isfinite(value)) {
            sign = 0;
            inside[i] = NO_BOUNDARY;
        } else if (relations[i].floor) {
            sign = value - mode < mode + 1 - value ? 1 : -1;
            inside[i] = s->slack[i] + (sign > 0 ? value - mode : mode + 1 - value);
        } else {
            inside[i] = s->slack[i] + mode * value;
            if (is_held(self, seen, i)) inside[i] = fmax(inside[i], s->slack[i]);
        }
        rates[i] = sign == 0 ? 0 : sign * seen->rates[i];
    }
}

bool inside_at(Instance *self, const Point *at, double inside[], double rates[]) {
    Seen seen;
    if (!follow(self, at) || !see(self, at, &seen)) return false;
    measure(self, at->u + NU - N_MODES, &seen, inside, rates);
    return true;
}

Status get_insides(Instance *self, double inside[]) {
    Seen seen;
    const Status status = watch_relations(self, &seen);
    if (status != OK) return status;
    double all[ROOM(N_MODES)], rates[ROOM(N_MODES)];
    measure(self, self->state.values + FIRST_MODE, &seen, all, rates);
    for (int i = 0, k = 0; i < N_MODES; i++)
        if (!relations[i].of_time) inside[k++] = all[i];
    return OK;
}

/* The first modes by the values of arguments alone; what has none compares false. */
static void guess_modes(Instance *self, int count) {
    double *modes = self->state.values + FIRST_MODE;
    Seen seen;
    const Point at = present(self);
    const bool defined = see(self, &at, &seen);
    for (int i = 0; i < count; i++) {
        const double value = defined ? seen.arguments[i] : NAN;
        if (!isfinite(value))
            modes[i] = relations[i].at_zero ? -1 : 1;
        else
            modes[i] = relations[i].floor ? floor(value) : value >= 0 ? 1 : -1;
    }
}

double event_time(const Instance *self) {
    const double now = self->state.values[TIME], next = self->state.switching.next;
    const bool early = self->state.interface == INTERFACE_ME && next != NOT_PLANNED && next > now &&
                       next - now <= SAME_TIME * fmax(fabs(now), fabs(next));
    return early ? next : now;
}

void evaluate_timed(Instance *self, double t, double arguments[], double rates[]) {
    const Point at = present(self);
    pass(self, &at);
    self->arg[0] = &t;
    self->res[0] = arguments;
    self->res[1] = rates;
    if (model_timed(self->arg, self->res, self->iw, self->w, 0))
        for (int i = 0; i < N_MODES; i++) arguments[i] = rates[i] = NAN;
}

static double argument_at(Instance *self, int i, double t) {
    double arguments[N_MODES], rates[N_MODES];
    evaluate_timed(self, t, arguments, rates);
    return arguments[i];
}

/* The mode of an argument that is not 0. One of time alone may be due a little later, or have
   jumped with another mode; at a start, what only rounding is before happens. */
static double by_value(Instance *self, const Seen *seen, int i, double value) {
    const RelationInfo *relation = &relations[i];
    if (relation->of_time) {
        const bool planned = self->state.switching.next != NOT_PLANNED;
        const double t = event_time(self), rate = seen->rates[i];
        if (relation->linear)
            value += rate * (t - self->state.values[TIME]);
        else if (t != self->state.values[TIME])
            value = argument_at(self, i, t);
        const double boundary = relation->floor ? round(value) : 0;
        if (fabs(value - boundary) <= 8 * DBL_EPSILON * fabs(t * rate)) {
            if (planned) return self->state.values[FIRST_MODE + i];
            if (relation->linear) value = relation->floor ? boundary - (rate < 0) : rate;
        }
    }
    return relation->floor ? floor(value) : value > 0 ? 1 : -1;
}

/* The mode that value and rates require; `zero` tells whether the argument is 0. */
static double required(Instance *self, const Seen *seen, int i, bool *zero) {
    const Switching *s = &self->state.switching;
    const RelationInfo *relation = &relations[i];
    const double mode = self->state.values[FIRST_MODE + i];
    const bool jumps = relation->of_time && s->due[i] == JUMPS;
    const double value =
        jumps ? argument_at(self, i, event_time(self)) : seen->arguments[i] - s->offsets[i];
    const double boundary = relation->floor ? round(value) : 0;
    if (!isfinite(value)) return mode;
    if (jumps) return relation->floor ? floor(value) : value >= 0 ? 1 : -1;
    if (!*zero && value != boundary) return by_value(self, seen, i, value);
    *zero = true;
    const double tiny = ROUNDING * seen->sizes[i];
    const double rates[] = {seen->rates[i], seen->seconds[i]};
    for (int k = 0; k < 2; k++) {
        const bool up = rates[k] > 0;
        if (!(fabs(rates[k]) > tiny)) continue;
        if (relation->floor) return up ? boundary : boundary - 1;
        return up ? 1 : -1;
    }
    if (relation->floor) return boundary;
    return relation->at_zero ? relation->at_zero : mode;
}

static void note_slack(Instance *self) {
    Switching *s = &self->state.switching;
    double sizes[ROOM(NX)], moved[ROOM(N_MODES)] = {0};
    const Point at = present(self);
    for (int i = 0; i < NX; i++) sizes[i] = variables[FIRST_STATE + i].nominal;
    pass(self, &at);
    self->arg[5] = sizes;
    self->res[0] = moved;
    if (model_rounding(self->arg, self->res, self->iw, self->w, 0)) return;
    for (int i = 0; i < N_MODES; i++) s->slack[i] = isfinite(moved[i]) ? ROUNDING * moved[i] : 0;
}

/* End the sliding of relations whose modes have left -1 ... 1; true if there are any. */
static bool release(Instance *self, bool zero[]) {
    double *modes = self->state.values + FIRST_MODE;
    bool any = false;
    for (int i = 0; i < N_MODES; i++) {
        if (!(self->state.switching.slides[i] > 0) || fabs(modes[i]) <= 1 + EDGE) continue;
        self->state.switching.slides[i] = 0;
        modes[i] = modes[i] > 0 ? 1 : -1;
        zero[i] = any = true;
    }
    return any;
}

/* Change the first mode that is not consistent, or let its relation slide. */
static Status change_one(Instance *self, const Seen *seen, bool zero[], const bool decided[],
                         bool *changed) {
    double *modes = self->state.values + FIRST_MODE;
    for (int i = 0; i < N_MODES; i++) {
        if (self->state.switching.slides[i] > 0 || decided[i]) continue;
        bool at_zero = zero[i];
        const double mode = required(self, seen, i, &at_zero);
        if (mode == modes[i]) continue;
        *changed = true;
        modes[i] = mode;
        if (!at_zero || relations[i].floor) return OK;
        Seen other;
        const Status status = watch_relations(self, &other);
        if (status == OK && required(self, &other, i, &at_zero) != mode) {
            self->state.switching.slides[i] = 1;
            zero[i] = true;
        }
        return status;
    }
    return OK;
}

/* Whether an argument that became 0 came to rest beyond it, where its value decides. */
static bool rests_beyond(const Instance *self, const Seen *seen, int i) {
    const Switching *s = &self->state.switching;
    if (relations[i].floor || s->slides[i] > 0) return false;
    const double past = self->state.values[FIRST_MODE + i] * (seen->arguments[i] - s->offsets[i]);
    return fmax(fabs(seen->rates[i]), fabs(seen->seconds[i])) <= ROUNDING && past < -ROUNDING;
}

/* Find modes that are consistent with what follows.

   `zero`: relations whose arguments are 0, whatever rounding makes of them; more may be found.
   `decided`: relations that keep their modes although their arguments are 0. */
Status settle_modes(Instance *self, bool zero[], const bool decided[], Status severity) {
    Switching *s = &self->state.switching;
    Seen seen;
    self->state.stale |= AFTER_START;
    for (int trial = 0; trial < MOST_ROUNDS; trial++) {
        Status status = watch_relations(self, &seen);
        note_slack(self);
        for (int i = 0; i < N_MODES && trial == 0 && status == OK; i++)
            if (zero[i] && rests_beyond(self, &seen, i)) zero[i] = false;
        bool changed = status == OK && release(self, zero);
        if (status == OK && !changed) status = change_one(self, &seen, zero, decided, &changed);
        if (status != OK)
            return severity == DISCARD ? status
                                       : refuse(self, severity, "no event is possible at %.12g s",
                                                self->state.values[TIME]);
        if (changed) continue;
        for (int i = 0; i < N_MODES; i++) {
            const double value = seen.arguments[i], tiny = ROUNDING * seen.sizes[i];
            s->stays[i] = 0;
            if (!zero[i] || relations[i].of_time || !isfinite(value)) continue;
            if (fmax(fabs(seen.rates[i]), fabs(seen.seconds[i])) <= tiny) s->stays[i] = tiny;
            s->offsets[i] = relations[i].floor ? value - round(value) : value;
        }
        return OK;
    }
    int last = 0;
    for (int i = 0; i < N_MODES; i++)
        if (zero[i]) last = i;
    return refuse(self, severity, "no consistent modes at %.12g s after %d trials (%s)",
                  self->state.values[TIME], MOST_ROUNDS, relations[last].name);
}

Status begin_modes(Instance *self) {
    State *state = &self->state;
    bool zero[ROOM(N_MODES)] = {0};
    const bool decided[ROOM(N_MODES)] = {0};
    memset(&state->switching, 0, sizeof state->switching);
    state->switching.next = state->switching.last = NOT_PLANNED;
    for (int i = 0; i < N_MODES; i++) state->values[FIRST_MODE + i] = 1;
    /* arguments may hold the modes of others, most of them of relations before them */
    for (int i = 1; i <= N_MODES; i++) guess_modes(self, i);
    guess_modes(self, N_MODES);
    return settle_modes(self, zero, decided, DISCARD);
}

#else
typedef int no_modes; /* C knows no empty file */
#endif
