/* Sends a byte every millisecond from the interrupt: whether main has run. */
#include "uart.h"

static volatile uint8_t alive;

ISR(TIMER0_COMPA_vect)
{
	UDR0 = alive;
	alive = 0;
}

int main(void)
{
	uart_begin();
	TCCR0A = 1 << WGM01;
	OCR0A = 249;
	TIMSK0 = 1 << OCIE0A;
	TCCR0B = 1 << CS01 | 1 << CS00;
	sei();
	for (;;) {
		cli();
		alive = 1;
		sei();
	}
}
