/* Answers each byte with the ADC's counts of A0, of A0 pulled up, and of the bandgap. */
#include "uart.h"

static void measure(void)
{
	ADCSRA |= 1 << ADSC;
	while (ADCSRA & 1 << ADSC)
		;
	uint16_t counts = ADC;
	uart_send(counts);
	uart_send(counts >> 8);
}

int main(void)
{
	uart_begin();
	ADCSRA = 1 << ADEN | 7;
	for (;;) {
		uart_receive();
		ADMUX = 1 << REFS0;
		measure();
		PORTC |= 1;
		measure();
		PORTC &= ~1;
		ADMUX = 1 << REFS0 | 0xE;
		measure();
	}
}
