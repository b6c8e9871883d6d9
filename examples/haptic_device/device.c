/* The device, the hand and the coupling of haptic_device.py as an FMU for co-simulation, FMI 2.0.
 *
 * A step of length T: the device goes on by T under the coupling's pull, then the tool's next position is found from
 * the tissue's force that was set before the step. Operations stand in the order of the Python loop, so that both give
 * the same bits. No log, no states, one step length.
 */
#include <stdlib.h>
#include <string.h>

typedef double Real;
typedef unsigned int Reference;
typedef int Status; /* 0: OK, 3: error */
#define API __attribute__((visibility("default")))
#define SUBSTEPS 10

/* By value reference; the same order as in modelDescription.xml. */
enum {
    FORCE, TOOL, POSITION, PULL, PASSIVITY,
    MASS, DAMPING, FRICTION, HAND_MASS, HAND_STIFFNESS, HAND_DAMPING, START, LOW, HIGH, PERIOD,
    STIFFNESS, COUPLING_DAMPING, TOOL_MASS, COUNT
};

static const Real DEFAULTS[COUNT] = {
    0, 0.042, 0.042, 0, 0, 0.06, 0.3, 0, 0.1, 300, 3, 0.042, 0.034, 0.041, 1, 300, 0.05, 0.01};

typedef struct {
    Real value[COUNT];
    Real speed, last, stretch, work, heat;
    long ticks;
} Device;

static Real path(const Device *d, Real time) {
    const Real *p = d->value;
    Real stroke = 2.0 * time / p[PERIOD];
    long whole = (long)stroke;
    Real u = stroke - (Real)whole;
    Real smooth = u * u * (3.0 - 2.0 * u);
    Real top = whole == 0 ? p[START] : p[HIGH];
    return top + (p[LOW] - top) * (whole % 2 == 0 ? smooth : 1.0 - smooth);
}

/* The tool's next position and the coupling's pull: `tick` of the Python loop. */
static void lead(Device *d, Real T) {
    Real *p = d->value;
    Real rate = p[COUPLING_DAMPING] / T, inertia = p[TOOL_MASS] / (T * T);
    Real apart = p[POSITION] - p[TOOL];
    Real push = inertia * (p[TOOL] - d->last) + p[STIFFNESS] * apart + rate * (apart - d->stretch) + p[FORCE];
    Real y = p[TOOL] + push / (inertia + p[STIFFNESS] + rate);
    Real stretch = p[POSITION] - y;
    p[PULL] = p[STIFFNESS] * stretch + rate * (stretch - d->stretch);
    d->stretch = stretch;
    d->last = p[TOOL];
    p[TOOL] = y;
}

/* Device and hand for one step: `move` of the Python loop. */
static void move(Device *d, Real T) {
    Real *p = d->value;
    Real h = T / SUBSTEPS, mass = p[MASS] + p[HAND_MASS];
    Real begin = path(d, (Real)d->ticks * T), end = path(d, (Real)(d->ticks + 1) * T);
    Real rate = (end - begin) / T, inertia = 2.0 * mass / h;
    Real whole = inertia + p[DAMPING] + p[HAND_DAMPING] + p[HAND_STIFFNESS] * h / 2.0;
    Real x = p[POSITION], v = d->speed, heat = 0.0;
    for (int s = 0; s < SUBSTEPS; s++) {
        Real at = begin + rate * (((Real)s + 0.5) * h);
        Real push = inertia * v - p[PULL] + p[HAND_STIFFNESS] * (at - x) + p[HAND_DAMPING] * rate;
        Real mean = (push > p[FRICTION] ? push - p[FRICTION] : push < -p[FRICTION] ? push + p[FRICTION] : 0.0) / whole;
        heat += p[DAMPING] * mean * mean + p[FRICTION] * (mean < 0.0 ? -mean : mean);
        x += mean * h;
        v = 2.0 * mean - v;
    }
    d->work += p[PULL] * (x - p[POSITION]);
    d->heat += heat * h;
    p[PASSIVITY] = d->work + d->heat;
    p[POSITION] = x;
    d->speed = v;
    d->ticks++;
}

static void begin(Device *d) {
    memset(d, 0, sizeof *d);
    memcpy(d->value, DEFAULTS, sizeof DEFAULTS);
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const void *calls, int seen,
                          int log) {
    (void)name, (void)guid, (void)place, (void)calls, (void)seen, (void)log;
    Device *d = type == 1 ? malloc(sizeof *d) : NULL;
    if (d) begin(d);
    return d;
}
API void fmi2FreeInstance(void *c) { free(c); }
API Status fmi2SetupExperiment(void *c, int has, Real tolerance, Real start, int ends, Real end) {
    (void)c, (void)has, (void)tolerance, (void)start, (void)ends, (void)end;
    return 0;
}
API Status fmi2EnterInitializationMode(void *c) { return c ? 0 : 3; }
API Status fmi2ExitInitializationMode(void *c) {
    Device *d = c;
    d->value[TOOL] = d->value[POSITION] = d->last = d->value[START];
    return 0;
}
API Status fmi2Terminate(void *c) { return c ? 0 : 3; }
API Status fmi2Reset(void *c) { return begin(c), 0; }

API Status fmi2GetReal(void *c, const Reference *r, size_t n, Real *v) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT) return 3;
        v[i] = ((Device *)c)->value[r[i]];
    }
    return 0;
}
API Status fmi2SetReal(void *c, const Reference *r, size_t n, const Real *v) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT || (r[i] > FORCE && r[i] < MASS)) return 3;
        ((Device *)c)->value[r[i]] = v[i];
    }
    return 0;
}
API Status fmi2DoStep(void *c, Real time, Real step, int keep) {
    (void)time, (void)keep;
    move(c, step);
    lead(c, step);
    return 0;
}
API Status fmi2CancelStep(void *c) { return (void)c, 3; }

/* What hosts look up and this FMU has not. */
#define NONE(name) API Status name(void *c) { return (void)c, 3; }
NONE(fmi2SetDebugLogging) NONE(fmi2GetInteger) NONE(fmi2GetBoolean) NONE(fmi2GetString)
NONE(fmi2SetInteger) NONE(fmi2SetBoolean) NONE(fmi2SetString)
NONE(fmi2GetFMUstate) NONE(fmi2SetFMUstate) NONE(fmi2FreeFMUstate)
NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate) NONE(fmi2DeSerializeFMUstate)
NONE(fmi2GetDirectionalDerivative) NONE(fmi2SetRealInputDerivatives) NONE(fmi2GetRealOutputDerivatives)
NONE(fmi2GetStatus) NONE(fmi2GetRealStatus) NONE(fmi2GetIntegerStatus) NONE(fmi2GetBooleanStatus)
NONE(fmi2GetStringStatus)
