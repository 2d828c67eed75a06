/* ------------------------------------------------------------------------------------------------------------------
   The command line. With -DDIESELTWIN_LIBRARY only the functions above are compiled.
   ------------------------------------------------------------------------------------------------------------------ */
#ifndef DIESELTWIN_LIBRARY

#include <errno.h>
#if defined(__unix__) || defined(__APPLE__)
#include <sys/stat.h>

/* Whether it is there and no file, as /dev/stdout, which can't be replaced. */
static int is_device(const char *path)
{
    struct stat about;
    return !stat(path, &about) && !S_ISREG(about.st_mode);
}

/* Whether two names are those of one file. */
static int is_same(const char *one, const char *other)
{
    struct stat a, b;
    return !stat(one, &a) && !stat(other, &b) && a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}
#else
static int is_device(const char *path)
{
    (void)path;
    return 0;
}

static int is_same(const char *one, const char *other)
{
    return !strcmp(one, other);
}
#endif

static char *unfinished; /* the file that is being written; none is left behind half-written */

static void fail(const char *what, const char *got, const char *allowed)
{
    if (unfinished)
        remove(unfinished);
    fprintf(stderr, "simulate: %s: got %s; allowed: %s\n", what, got, allowed);
    exit(2);
}

/* One line of a file without its end, in a buffer that grows; NULL at the end of the file. */
static char *read_line(FILE *file, char **buffer, size_t *size)
{
    size_t length = 0;
    int c;
    while ((c = fgetc(file)) != EOF && c != '\n') {
        if (length + 2 > *size) {
            *size = *size ? 2 * *size : 1024;
            *buffer = realloc(*buffer, *size);
            if (!*buffer)
                fail("memory", "none left", "a shorter file");
        }
        (*buffer)[length++] = (char)c;
    }
    if (c == EOF && length == 0)
        return NULL;
    if (!*buffer)
        *buffer = calloc(*size = 16, 1);
    if (length && (*buffer)[length - 1] == '\r')
        length--;
    (*buffer)[length] = 0;
    return *buffer;
}

/* Columns that are read: the inputs, then states of the first row. */
static const char *const COLUMNS[] = {"time_s", INPUT_NAMES, "p_im_pa", "p_em_pa", "omega_t_rad_s"};
enum { N_COLUMNS = sizeof COLUMNS / sizeof COLUMNS[0] };

static void parse(char *line, const int at[N_COLUMNS], double row[N_COLUMNS], long number)
{
    int field = 0;
    for (int j = 0; j < N_COLUMNS; j++)
        row[j] = NAN;
    for (char *cell = line; cell; field++) {
        char *comma = strchr(cell, ','), *end;
        if (comma)
            *comma = 0;
        for (int j = 0; j < N_COLUMNS; j++)
            if (at[j] == field) {
                row[j] = strtod(cell, &end);
                if (end == cell || *end)
                    row[j] = NAN;
            }
        cell = comma ? comma + 1 : NULL;
    }
    for (int j = 0; j < N_INPUTS + 1; j++)
        if (!isfinite(row[j])) {
            char where_[96];
            snprintf(where_, sizeof where_, "data row %ld, column %s", number, COLUMNS[j]);
            fail(where_, "no number", "a number in every row of an input");
        }
}

static void write_row(FILE *out, const Engine *e)
{
    double values[N_OUTPUTS];
    engine_outputs(e, values);
    for (int j = 0; j < N_OUTPUTS; j++)
        fprintf(out, j ? ",%.10g" : "%.10g", values[j]);
    fputc('\n', out);
}

int main(int count, char **arguments)
{
    static Engine e;
    e.c = engine_constants();
    if (count < 3) {
        fprintf(stderr, "usage: %s INPUTS.csv OUT.csv [PARAMETER=VALUE ...]\n"
                "INPUTS.csv has a line of names and the columns time_s", arguments[0]);
        for (int j = 1; j <= N_INPUTS; j++)
            fprintf(stderr, ", %s", COLUMNS[j]);
        fprintf(stderr, "; p_im_pa, p_em_pa, omega_t_rad_s\nof its first row are where the states start, without them "
                "the engine starts at rest. Parameters:\n");
        for (int j = 0; j < N_PARAMETERS; j++)
            fprintf(stderr, "  %s=%.10g\n", PARAMETER_NAMES[j], *engine_parameter(&e, j));
        return 2;
    }
    for (int i = 3; i < count; i++) {
        char *value = strchr(arguments[i], '='), *end;
        int found = -1;
        for (int j = 0; value && j < N_PARAMETERS; j++)
            if (strlen(PARAMETER_NAMES[j]) == (size_t)(value - arguments[i]) &&
                !strncmp(PARAMETER_NAMES[j], arguments[i], (size_t)(value - arguments[i])))
                found = j;
        if (found < 0)
            fail("arguments", arguments[i], "NAME=VALUE with a parameter's name (run without arguments for a list)");
        *engine_parameter(&e, found) = strtod(value + 1, &end);
        if (end == value + 1 || *end || !isfinite(*engine_parameter(&e, found)))
            fail(arguments[i], "no number", "a number");
    }
    FILE *in = fopen(arguments[1], "r");
    if (!in)
        fail(arguments[1], strerror(errno), "a file that can be read");
    char *buffer = NULL;
    size_t size = 0;
    char *line = read_line(in, &buffer, &size);
    if (!line)
        fail(arguments[1], "an empty file", "a line of names and two rows or more");
    int at[N_COLUMNS];
    for (int j = 0; j < N_COLUMNS; j++) {
        at[j] = -1;
        int field = 0;
        for (const char *cell = line; cell; field++) {
            const char *comma = strchr(cell, ',');
            const size_t length = comma ? (size_t)(comma - cell) : strlen(cell);
            if (length == strlen(COLUMNS[j]) && !strncmp(cell, COLUMNS[j], length))
                at[j] = field;
            cell = comma ? comma + 1 : NULL;
        }
        if (at[j] < 0 && j < N_INPUTS + 1)
            fail(arguments[1], "no such column", COLUMNS[j]);
    }
    double now[N_COLUMNS], next[N_COLUMNS];
    line = read_line(in, &buffer, &size);
    if (!line)
        fail(arguments[1], "no rows", "two rows or more");
    parse(line, at, now, 1);
    if (is_same(arguments[1], arguments[2]) && !is_device(arguments[2]))
        fail(arguments[2], "the file of the inputs", "another file for the results");
    if (!is_device(arguments[2])) { /* results take the place of earlier ones when all of them are there */
        static const char ENDING[] = ".partial";
        const size_t length = strlen(arguments[2]);
        unfinished = malloc(length + sizeof ENDING);
        if (!unfinished)
            fail("memory", "none left", "a shorter name");
        memcpy(unfinished, arguments[2], length);
        memcpy(unfinished + length, ENDING, sizeof ENDING);
    }
    FILE *out = fopen(unfinished ? unfinished : arguments[2], "w");
    if (!out)
        fail(arguments[2], strerror(errno), "a file that can be written");
    for (int j = 0; j < N_OUTPUTS; j++)
        fprintf(out, "%s%s", j ? "," : "", OUTPUT_NAMES[j]);
    fputc('\n', out);
    engine_start(&e, now[0], inputs_of(now + 1), now[N_INPUTS + 1], now[N_INPUTS + 2], now[N_INPUTS + 3]);
    for (long number = 2; (line = read_line(in, &buffer, &size)); number++) {
        if (!*line)
            continue;
        parse(line, at, next, number);
        if (next[0] <= now[0])
            fail(arguments[1], "time stamps that don't increase", "strictly increasing time_s");
        engine_hold(&e, inputs_of(next + 1), next[0] - now[0]);
        write_row(out, &e);
        engine_step(&e, inputs_of(now + 1), inputs_of(next + 1), next[0] - now[0]);
        e.time_s = next[0];
        memcpy(now, next, sizeof now);
    }
    write_row(out, &e);
    free(buffer);
    fclose(in);
    if (ferror(out) | fclose(out))
        fail(arguments[2], strerror(errno), "room for the results");
    if (unfinished && rename(unfinished, arguments[2])) {
        remove(arguments[2]); /* some systems don't rename to a name that is taken */
        if (rename(unfinished, arguments[2]))
            fail(arguments[2], strerror(errno), "a file that can be written");
    }
    free(unfinished);
    return 0;
}

#endif
